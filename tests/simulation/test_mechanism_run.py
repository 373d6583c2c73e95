"""Simulated chains with branches: energy, closed grasps, the order of the scheme, and runs of serial chains."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import MethodNotApplicable, ModelError, StateError
from holdfast.model.grasp_rows import row_name
from holdfast.simulation.trajectory import EMPTY_FIELDS
from tests.dynamics.tree.as_branched import AWAY, STRAY, gap
from tests.longer import mostly_slow
from tests.systems.branched import branched_problems, palletiser


def constant(tau):
    """Return a controller with constant torques."""
    return lambda t, state, memory: (tau, memory)


@pytest.mark.parametrize("name", mostly_slow(branched_problems(), ("palletiser", "on a shoulder")))
def test_accounts(name):
    """Closures stay closed, coupled joints stay together, and work explains the energy to the order of the scheme."""
    chain, state, tau = branched_problems()[name]
    runs = [hf.simulate(chain, state, constant(tau), 0.02, step) for step in (4e-3, 2e-3)]
    coarse, fine = (np.abs(run.imbalance).max() for run in runs)
    assert coarse / 24 < fine < coarse / 12 or coarse < 1e-11
    assert fine < 1e-9
    run = runs[1]
    assert len(run) == 11 and run.stopped is None
    assert run.position_gap[:, 1].max() < 1e-12 and run.velocity_gap[:, 1].max() < 1e-9
    assert run.position_gap[1:, 0].min() >= 0.0 and run.rows == [row_name(key) for key in chain.as_forest.closures]
    assert np.abs(run.work[-1]).max() > 1e-4  # drives and dampers do work
    result = hf.forward_dynamics(chain, run.state(-1), tau)
    assert gap(run.qdd[-1], result.qdd) < 1e-12
    assert gap(run.grasp_wrench[-1], result.grasp_wrench) < 1e-11
    for coupling in chain.all_couplings:
        names = [*chain.joint_names()]
        at = {one: k + 3 * (name == "on a shoulder") for k, one in enumerate(names)}
        total = sum(c * run.q[:, at[one]] for one, c in coupling.terms.items())
        assert np.abs(total - total[0]).max() < 1e-12


def test_a_quaternion_keeps_its_length():
    """A link on a spherical joint without torques: unit quaternions, and energy that stays."""
    chain, state, tau = branched_problems()["on a shoulder"]
    run = hf.simulate(chain, state, constant(0.0 * tau), 0.02, 5e-3)
    assert gap(np.linalg.norm(run.q[:, 1:5], axis=1), np.ones(5)) < 1e-14
    assert gap(np.linalg.norm(run.base_pose[:, :4], axis=1), np.ones(5)) < 1e-14


@pytest.mark.slow
def test_order():
    """Half the step, a sixteenth of the error."""
    chain, state, tau = palletiser()
    ends = [hf.simulate(chain, state, constant(tau), 0.4, 0.4 / n).q[-1] for n in (4, 8, 64)]
    coarse, fine = (np.abs(end - ends[-1]).max() for end in ends[:-1])
    assert 12.0 < coarse / fine < 24.0


@pytest.mark.slow
def test_schemes():
    """The midpoint rule has order 2; adaptive steps of order 8 come to the motion of small steps, and keep energy."""
    chain, state, tau = palletiser()
    given = chain, state, constant(tau), 0.4
    exact = hf.simulate(*given, 0.2, scheme="dop853", rtol=1e-11)
    assert exact.stopped is None and np.abs(exact.imbalance).max() < 1e-9
    assert gap(exact.q[-1], hf.simulate(*given, 0.4 / 256).q[-1]) < 1e-8
    loose = hf.simulate(*given, 0.2, scheme="dop853", rtol=1e-6)
    assert len(loose) < len(exact) and 1e-13 < gap(loose.q[-1], exact.q[-1]) < 1e-6
    coarse, fine = (gap(hf.simulate(*given, h, scheme="midpoint").q[-1], exact.q[-1]) for h in (0.02, 0.01))
    assert 3.0 < coarse / fine < 5.0


@pytest.mark.slow
def test_divided_steps():
    """Steps that leave gaps are divided, as those of serial chains."""
    chain, state, tau = branched_problems()["grippers"]
    given = chain, state, constant(tau), 0.02, 1e-2
    limit = hf.simulate(*given).position_gap[:, 0].max() / 100
    assert 0.0 < hf.simulate(*given, largest_drift=limit).position_gap[:, 0].max() < 1.5 * limit


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"sample_time": 2e-3, "delay": 5e-4}])
def test_as_a_serial_chain(options):
    """Beside an object that falls, two arms move as the serial chain does by itself, with friction and wrenches.

    So they do under a sampled controller, whose torques are held and act late.
    """
    arms = {name: hf.robots.panda(hf.Pose.translation(0.0, y, 0.0)) for name, y in (("left", 0.35), ("right", -0.35))}
    arms = {name: arm.of([replace(joint, friction=0.02) for joint in arm.joints]) for name, arm in arms.items()}
    grasps = {
        name: hf.Grasp(kind, hf.contact_frame([0, 0.15 * y, 0], into=[0, -y, 0]))
        for name, kind, y in (("left", "rigid", 1), ("right", "ball", -1))
    }
    made = hf.assemble(
        arms, hf.HeldObject.box(3.0, 0.3, 0.3, 0.2), grasps, object_pose=hf.Pose.translation(0.6, 0, 0.4)
    )
    chain, state = made.chain, made.state
    push = np.array([0.0, 0.0, 0.0, 3.0, -2.0, 1.0])

    def law(t, at, memory):
        begun = 0 if memory is None else memory
        return 2.0 * np.cos(3.0 * t) - 1.5 * at.qd - 0.01 * begun, begun + 1

    wanted = hf.simulate(chain, state, law, 0.01, 1e-3, inputs=hf.Inputs(push), **options)
    several = replace(chain, objects={"stray": STRAY})
    there = replace(state, object_pose=[state.object_pose, AWAY], object_twist=np.zeros((2, 6)))

    def both(t):
        return hf.Inputs([push, np.zeros(6)])

    found = hf.simulate(several, there, law, 0.01, 1e-3, inputs=both, **options)
    assert gap(found.t, wanted.t) == 0.0
    assert gap(found.q, wanted.q) < 1e-9  # each is closed in its own metric
    assert gap(found.tau, wanted.tau) < 1e-9
    assert gap(found.grasp_wrench, wanted.grasp_wrench) < 1e-7
    assert gap(found.object_pose[:, 0], wanted.object_pose) < 1e-9
    fallen = AWAY.p[2] - 0.5 * 9.81 * found.t**2
    assert gap(found.object_pose[:, 1, 6], fallen) < 1e-7
    if not options:
        thinned = hf.simulate(several, there, law, 0.01, 1e-3, inputs=both, every=4)
        assert thinned.t.tolist() == found.t[[0, 4, 8, 10]].tolist()


def test_a_run_that_ends_early():
    """A parallelogram that reaches its flat posture stops there, and says why."""
    chain, state, tau = palletiser()
    lean = np.pi / 2 - 0.02
    state = hf.close(chain, hf.State([0.4, lean, -lean, lean], [0.0, 1.0, -1.0, 1.0]))
    run = hf.simulate(chain, state, constant(0.0 * tau), 0.1, 1e-3)
    assert 0.015 < run.t[-1] < 0.02  # the hand swings at 1 rad/s and is 0.02 rad away
    assert run.stopped.startswith(f"stopped after t = {run.t[-1]:.6g} s: the constraint has rank 1 of 3")
    assert "loop 'robot/level'" in run.stopped
    assert repr(run).startswith(f"<Trajectory run 'run' of robot: {len(run)} samples")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"scheme": "imex"}, "scheme"),
        ({"make_stepper": print}, "make_stepper"),
        ({"on_singular": "continue"}, "on_singular"),
        ({"base_motion": {"robot": None}}, "base_motion"),
    ],
)
def test_refusals(given, message):
    """What runs of forests do not do is refused by name."""
    chain, state, tau = palletiser()
    with pytest.raises(MethodNotApplicable, match=f"{message}: expected its default"):
        hf.simulate(chain, state, constant(tau), 0.02, 1e-2, **given)


def test_wrong_calls():
    """Wrong torques, controllers, states and base motion are refused."""
    chain, state, tau = palletiser()
    with pytest.raises(StateError, match="controller: torques: expected shape"):
        hf.simulate(chain, state, constant([1.0]), 0.02, 1e-2)
    with pytest.raises(StateError, match="'robot/wrist' is passive"):
        hf.simulate(chain, state, constant(np.ones(4)), 0.02, 1e-2)
    with pytest.raises(ModelError, match="controller: expected a function"):
        hf.simulate(chain, state, tau, 0.02, 1e-2)
    with pytest.raises(StateError, match="position gap"):
        hf.simulate(chain, replace(state, q=[0.4, 0.4, -0.3, 0.3]), constant(tau), 0.02, 1e-2)
    with pytest.raises(StateError, match="base_twists: expected none"):
        hf.simulate(chain, state, constant(tau), 0.02, 1e-2, inputs=hf.Inputs(base_twists=np.zeros((1, 6))))
    with pytest.raises(ModelError, match="on_slip: expected one of"):
        hf.simulate(chain, state, constant(tau), 0.02, 1e-2, on_slip="hope")
    with pytest.raises(MethodNotApplicable, match=r"record: .* got 'internal_wrench'"):
        hf.simulate(chain, state, constant(tau), 0.02, 1e-2, record=["q", "internal_wrench"])
    with pytest.raises(MethodNotApplicable, match="recording: run: chain"):
        hf.identification.Recording.of_run(hf.simulate(chain, state, constant(tau), 0.02, 1e-2))


def test_chosen_arrays():
    """A run records what is asked for, every few steps, with the bits of a run with everything."""
    chain, state, tau = palletiser()
    whole, heard = hf.simulate(chain, state, constant(tau), 0.02, 2e-3), []
    some = hf.simulate(chain, state, constant(tau), 0.02, 2e-3, record=["q", "margin"], every=4, on_sample=heard.append)
    assert some.t.tolist() == whole.t[[0, 4, 8, 10]].tolist()
    assert some.q.tolist() == whole.q[[0, 4, 8, 10]].tolist() and some.every == 4
    assert {*some.recorded} - {"t", "q", "margin"} == {*EMPTY_FIELDS} - {"trunk_base_wrench"}
    assert [float(one.t) for one in heard] == some.t.tolist()
    with pytest.raises(StateError, match=r"'momentum' was not recorded \(runs of chains with branches never have it"):
        _ = whole.momentum[0]
