"""Inverse dynamics of forests and chains with branches as machine code: forward dynamics gives it back, equal bits."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import holdfast as hf
from holdfast.dynamics import Status, forest_dynamics, forest_inverse_dynamics
from holdfast.errors import MethodNotApplicable, StateError
from holdfast.questions.arrays import state_fields
from tests.dynamics.tree.problems import gap, underactuated
from tests.longer import mostly_long, mostly_slow
from tests.systems.branched import branched_problems, palletiser
from tests.systems.humanoid import humanoid
from tests.systems.standing import humanoid_with_box


@pytest.mark.slow
@pytest.mark.parametrize("seed", [*mostly_slow(range(8), (4,)), *mostly_long(range(8, 30), ())])
def test_random_forests(seed):
    """Ten families, of which a third is over-constrained and a third of the joints has no drive, as the reference."""
    p = underactuated(seed)
    start = forest_dynamics(*p[1:])
    wanted = forest_inverse_dynamics(p.forest, p.q, p.qd, start.qdd, p.wrenches)
    code = hf.compile(p.forest, parameters=["link_wrench"])
    found = code.inverse_dynamics(p.q, p.qd, start.qdd, link_wrench=p.wrenches)
    print(f"{p.name}: {code.inverse_dynamics.operation_count} operations")
    assert found.status is Status.OK
    for name in ("tau", "closure_wrench", "coupling_force"):
        assert gap(getattr(found, name), getattr(wanted, name)) <= 1e-10, name
    again = code.forward_dynamics(p.q, p.qd, found.tau, link_wrench=p.wrenches)
    assert gap(again.qdd, start.qdd) <= 1e-10


@pytest.mark.slow
def test_humanoid():
    """All of a humanoid's joints have drives, six more than it has freedoms; its soles and hands carry the least."""
    p = humanoid()
    start = forest_dynamics(*p[1:])
    code = hf.compile(p.forest)
    found = code.inverse_dynamics(p.q, p.qd, start.qdd)
    wanted = forest_inverse_dynamics(p.forest, p.q, p.qd, start.qdd)
    assert gap(found.tau, wanted.tau) <= 1e-10 and gap(found.closure_wrench, wanted.closure_wrench) <= 1e-10
    assert gap(code.forward_dynamics(p.q, p.qd, found.tau).qdd, start.qdd) <= 1e-10


def asked(chain, state, tau=None):
    """Return accelerations that torques give, as arrays of a call with the state, and as arguments of the reference."""
    tau = np.zeros(chain.joint_count) if tau is None else tau
    at = {name: np.array(x) for name, f in state_fields(chain).items() if (x := getattr(state, f)) is not None}
    start, reference = hf.forward_dynamics(chain, state, tau), {}
    given = at | {"qdd": start.qdd}
    if chain.free_objects:
        given["object_acceleration"] = reference["object_acceleration"] = start.object_acceleration
    if chain.floats:
        given["floating_acceleration"] = reference["base_acceleration"] = start.base_acceleration
    return at, given, (chain, state, start.qdd), reference


@pytest.mark.slow
def test_soles():
    """A humanoid that stands on its soles with a box: redundant drives, rectangular soles, an object in its hands."""
    standing = humanoid_with_box()
    at, given, reference, further = asked(standing.chain, standing.state)
    code = hf.compile(standing.chain)
    found, wanted = code.inverse_dynamics(**given), hf.inverse_dynamics(*reference, **further)
    assert gap(found.tau, wanted.tau) <= 1e-10 and gap(found.grasp_wrench, wanted.grasp_wrench) <= 1e-10
    assert gap(code.forward_dynamics(tau=found.tau, **at).qdd, given["qdd"]) <= 1e-10


@pytest.mark.parametrize("name", mostly_slow(branched_problems(), ("palletiser", "on a shoulder")))
def test_chains(name):
    """Torques and wrenches of the reference, also nearest to wanted ones; equal bits in a batch, bound and pickled."""
    p = branched_problems()[name]
    _, given, reference, further = asked(p.chain, p.state, p.tau)
    code = hf.compile(p.chain)
    found, plain = code.inverse_dynamics(**given), hf.inverse_dynamics(*reference, **further)
    near = 0.9 * np.asarray(hf.forward_dynamics(p.chain, p.state, 1.1 * p.tau).grasp_wrench)
    pressed, wanted = (
        code.inverse_dynamics(**given, grasp_wrench=near),
        hf.inverse_dynamics(*reference, near, **further),
    )
    for result in ("tau", "grasp_wrench", "coupling_force"):
        assert gap(getattr(found, result), getattr(plain, result)) <= 1e-10
        assert gap(getattr(pressed, result), getattr(wanted, result)) <= 1e-10
    assert {*found.wrenches} == {*plain.wrenches}
    several = given | {"qdd": np.array([given["qdd"], 0.5 * given["qdd"]])}
    many = code.inverse_dynamics(**several, grasp_wrench=0.0 * near, threads=2)
    bound = code.inverse_dynamics.bind(**{key: np.array(x) for key, x in given.items()})
    again = pickle.loads(pickle.dumps(code)).inverse_dynamics(**given)
    assert code.inverse_dynamics(**given, out=pressed) is pressed and (pressed.tau == found.tau).all()
    assert bound() is found.status is Status.OK and "2 systems" in repr(many)
    for result in ("tau", "grasp_wrench", "coupling_force"):
        assert (getattr(many, result)[0] == getattr(found, result)).all()
        assert (getattr(bound.result, result) == getattr(found, result)).all()
        assert (getattr(again, result) == getattr(found, result)).all()
    assert all(many.wrenches[key].shape == (2, 6) for key in plain.wrenches)


def test_refusals():
    """What no forces carry, wrenches that a grasp does not transmit and derivatives are refused by name."""
    chain, state, tau = palletiser()
    _, given, _, _ = asked(chain, state, tau)
    code = hf.compile(chain)
    with pytest.raises(StateError, match=r"wrench of .*level.*grasp transmits"):
        code.inverse_dynamics(**given, grasp_wrench=np.full((1, 6), 50.0))  # about a pin, too
    with pytest.raises(StateError, match="qdd: expected shape"):
        code.inverse_dynamics(**given | {"qdd": [1.0]})
    with pytest.raises(MethodNotApplicable, match=r"'inverse_dynamics\.vjp': expected the answer alone"):
        _ = code.inverse_dynamics.vjp
    with pytest.raises(AttributeError, match="no attribute 'ops'"):
        _ = code.inverse_dynamics.ops


@pytest.mark.slow
def test_what_nothing_carries():
    """An object that nobody holds can only fall; in a batch only this system has no answer."""
    loose = hf.HeldObject.box(1.0, 0.1, 0.1, 0.1)
    chain = hf.ClosedChain({"arm": hf.robots.panda()}, objects={"loose": loose})
    state = hf.State(hf.robots.HOME["panda"], np.zeros(7), hf.Pose.translation(1, 0, 0))
    code, at = hf.compile(chain), {"q": state.q, "qd": state.qd, "qdd": np.zeros(7)}
    at |= {"object_pose": state.object_pose, "object_twist": np.zeros(6)}
    with pytest.raises(StateError, match=r"no wrench can carry body .*9\.81"):
        code.inverse_dynamics(**at, object_acceleration=np.zeros(6))
    falling = np.array([[0, 0, 0, 0, 0, -9.81], np.zeros(6)])
    found = code.inverse_dynamics(**at, object_acceleration=falling)
    assert [*found.status] == [Status.OK, Status.INVALID]
    assert np.isfinite(found.tau[0]).all() and np.isnan(found.tau[1]).all()
