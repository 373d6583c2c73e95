"""Chains with branches as machine code, in their own terms: numbers of the reference, batches, named refusals."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import holdfast as hf
from holdfast.compiled import CompiledMechanism
from holdfast.errors import MethodNotApplicable, StateError
from tests.dynamics.tree.as_branched import gap
from tests.longer import mostly_slow
from tests.systems.branched import Branched, branched_problems, palletiser, pot_and_lid


def arguments(p: Branched) -> dict:
    """Return the arrays of a call, without torques."""
    names = {"q": "q", "qd": "qd", "object_pose": "object_pose", "object_twist": "object_twist"}
    names |= {"floating_pose": "base_pose", "floating_twist": "base_twist"}
    return {name: x for name, field in names.items() if (x := getattr(p.state, field)) is not None}


@pytest.mark.parametrize("name", mostly_slow(branched_problems(), ("palletiser", "on a shoulder")))
def test_answers(name):
    """Accelerations, wrenches and status of the reference, with external wrenches; equal bits in a batch and bound."""
    p = branched_problems()[name]
    code = hf.compile(p.chain, parameters=["link_wrench"])
    assert isinstance(code, CompiledMechanism)
    rng, inputs = np.random.default_rng(1), hf.Inputs().shaped(p.chain)
    links = sum(arm.joint_count for arm in p.chain.arms.values())
    given = {"object_wrench": rng.normal(size=inputs.object_wrench.shape), "link_wrench": rng.normal(size=(links, 6))}
    pushed = hf.Inputs(object_wrench=given["object_wrench"], link_wrenches=given["link_wrench"])
    wanted = hf.forward_dynamics(p.chain, p.state, p.tau, inputs=pushed)
    found = code.forward_dynamics(tau=p.tau, **arguments(p), **given)
    assert gap(found.qdd, wanted.qdd) <= 1e-11
    assert gap(found.object_acceleration, wanted.object_acceleration) <= 1e-11
    if p.state.base_pose is not None:
        assert gap(found.base_acceleration, wanted.base_acceleration) <= 1e-11
    assert (found.rank, found.mobility, found.status) == (wanted.rank, wanted.mobility, wanted.status)
    assert {*found.accelerations} == {*wanted.accelerations} and {*found.wrenches} == {*wanted.wrenches}
    if wanted.status is hf.dynamics.Status.OK:
        assert gap(found.grasp_wrench, wanted.grasp_wrench) <= 1e-10
        assert gap(found.coupling_force, wanted.coupling_force) <= 1e-10
    many = code.forward_dynamics(tau=np.array([p.tau, 0.5 * p.tau]), **arguments(p), **given)
    assert "2 systems of" in repr(many) and str(wanted.rank) in repr(found)
    bound = code.bind(**{name: np.array(x) for name, x in (arguments(p) | given).items()}, tau=np.array(p.tau))
    assert bound() is found.status
    for result in ("qdd", "grasp_wrench", "coupling_force"):
        assert (getattr(many, result)[0] == getattr(found, result)).all()
        assert (getattr(bound.result, result) == getattr(found, result)).all()
    again = pickle.loads(pickle.dumps(code)).forward_dynamics(tau=p.tau, **arguments(p), **given)
    assert (again.qdd == found.qdd).all()


def test_inputs():
    """Wrong arrays, torques of passive joints and options of serial chains are refused by name."""
    p = palletiser()
    code = hf.compile(p.chain)
    with pytest.raises(StateError, match="qd: expected shape"):
        code.forward_dynamics(p.state.q, p.state.qd[1:], p.tau)
    with pytest.raises(StateError, match="passive"):
        code.forward_dynamics(p.state.q, p.state.qd, p.tau + 1.0)
    with pytest.raises(StateError, match="passive"):
        code.forward_dynamics(p.state.q, p.state.qd, np.array([p.tau, p.tau - 1.0]))
    with pytest.raises(StateError, match="link_wrench: expected none; try"):
        code.forward_dynamics(p.state.q, p.state.qd, p.tau, link_wrench=np.zeros((3, 6)))
    with pytest.raises(MethodNotApplicable, match="generic_rank: expected its default"):
        hf.compile(p.chain, generic_rank=3)
    with pytest.raises(StateError, match="out: expected a result"):
        code.forward_dynamics(p.state.q, p.state.qd, p.tau, out=code)
    with pytest.raises(MethodNotApplicable, match="'mass_matrix': expected forward_dynamics of a forest"):
        _ = code.mass_matrix
    with pytest.raises(AttributeError, match=r"no attribute 'forward'\. Did you mean 'forward_dynamics'"):
        _ = code.forward
    bound = code.bind(q=np.array(p.state.q), qd=np.array(p.state.qd), tau=p.tau + 1.0)
    assert bound() is hf.dynamics.Status.INVALID  # a torque of a passive joint


@pytest.mark.slow
def test_several_objects():
    """Poses are needed if there are objects, with unit quaternions."""
    p = pot_and_lid()
    code = hf.compile(p.chain)
    with pytest.raises(StateError, match="got no object_pose and no object_twist"):
        code.forward_dynamics(p.state.q, p.state.qd, p.tau)
    with pytest.raises(StateError, match="unit"):
        code.forward_dynamics(tau=p.tau, **arguments(p) | {"object_pose": 1.1 * p.state.object_pose})
    found = code.forward_dynamics(
        tau=p.tau, **arguments(p) | {"object_pose": np.array([p.state.object_pose, 1.1 * p.state.object_pose])}
    )
    assert [*found.status] == [found.status[0], hf.dynamics.Status.INVALID]
