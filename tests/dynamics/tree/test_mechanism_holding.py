"""Torques that hold chains with branches, or accelerate their objects."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast.errors import MethodNotApplicable, StateError
from tests.dynamics.tree.as_branched import gap
from tests.systems.branched import branched_problems, palletiser, two_arms_with_grippers


def two_pandas() -> tuple[hf.ClosedChain, hf.State]:
    """Return two arms that hold a box."""
    arms = {name: hf.robots.panda(hf.Pose.translation(0.0, y, 0.0)) for name, y in (("left", 0.35), ("right", -0.35))}
    grasps = {
        name: hf.Grasp("rigid", hf.contact_frame([0, 0.15 * y, 0], into=[0, -y, 0]))
        for name, y in (("left", 1), ("right", -1))
    }
    box, at = hf.HeldObject.box(3.0, 0.3, 0.3, 0.2), hf.Pose.translation(0.6, 0, 0.4)
    made = hf.assemble(arms, box, grasps, object_pose=at)
    return made.chain, made.state


@pytest.mark.parametrize("name", ["grippers", "palletiser", "pot and lid"])
def test_what_is_held_stays(name):
    """At rest under its own torques; with an internal force, too."""
    p = branched_problems()[name]
    state = p.state.at_rest()
    for push in (0.0, 5.0):
        tau = hf.holding_torques(p.chain, state, internal_force=push)
        tau += 0.0  # a user may change it
        found = hf.forward_dynamics(p.chain, state, tau)
        assert np.abs(found.qdd).max() < 1e-9
        assert np.abs(found.object_acceleration).max(initial=0.0) < 1e-9


def test_an_acceleration():
    """The box accelerates as asked, also in motion."""
    p = branched_problems()["grippers"]
    moving = hf.close(p.chain, replace(p.state, qd=0.2 * p.state.qd))
    alpha = np.array([0.1, -0.2, 0.3, 0.2, 0.1, 0.4])
    found = hf.forward_dynamics(p.chain, moving, hf.holding_torques(p.chain, moving, alpha))
    assert gap(found.object_acceleration, alpha) < 1e-9


@pytest.mark.parametrize("push", [0.0, 20.0])
def test_as_the_serial_chain(push):
    """A coupling that is at rest anyhow changes nothing: torques are those of the serial chain."""
    chain, state = two_pandas()
    alone = hf.holding_torques(chain, state, internal_force=push)
    names = chain.joint_names()
    geared = replace(chain, couplings=[hf.Coupling({names[0]: 1.0, names[7]: 1.0}, None)])
    assert gap(hf.holding_torques(geared, state, internal_force=push), alone) < 1e-9
    law = hf.control.GravityCompensation(geared, internal_force=push, joint_damping=2.0)
    wanted = hf.control.GravityCompensation(chain, internal_force=push, joint_damping=2.0)
    assert gap(law(0.0, state, None)[0], wanted(0.0, state, None)[0]) < 1e-9
    turning = replace(state, qd=np.ones(14))
    assert gap(law(0.0, turning, None)[0], law(0.0, state, None)[0] - 2.0) < 1e-12


def test_a_run_under_gravity_compensation():
    """A palletiser that is held against its weight comes to rest by its dampers; passive joints get no torque."""
    chain, state, _ = palletiser()
    law = hf.control.GravityCompensation(chain, joint_damping=20.0)
    assert not law(0.0, state, None)[0][2:].any()
    run = hf.simulate(chain, state, law, 0.1, 2e-2)
    assert run.kinetic[-1] < 0.7 * run.kinetic[0]
    assert np.abs(run.imbalance).max() < 1e-4 * run.kinetic[0]


def test_refusals():
    """Wrong shapes, names of passive joints, and what no drive carries."""
    chain, state, _ = two_arms_with_grippers()
    with pytest.raises(StateError, match=r"acceleration: expected shape \(6,\)"):
        hf.holding_torques(chain, state, np.zeros(3))
    with pytest.raises(MethodNotApplicable, match="passive: expected its default"):
        hf.holding_torques(chain, state, passive=["arm1/joint1"])
    loose = replace(chain, objects={"stray": hf.HeldObject.box(1.0, 0.1, 0.1, 0.1)})
    there = replace(state, object_pose=[state.object_pose, hf.Pose.identity()], object_twist=np.zeros((2, 6)))
    with pytest.raises(StateError, match="no wrench can carry body 17 'stray'"):
        hf.holding_torques(loose, there)


def test_gravity_compensation_within_a_step():
    """A stage of a step is closed but for the step's error, for which the law allows."""
    p = branched_problems()["grippers"]
    law, state = hf.control.GravityCompensation(p.chain), p.state.at_rest()
    beside = replace(state, q=state.q + 1e-5 * np.random.default_rng(4).normal(size=len(state.q)))
    with pytest.raises(StateError, match="does not satisfy the forest"):
        hf.holding_torques(p.chain, beside)
    exact, near = (law(0.0, one, None)[0] for one in (state, beside))
    assert 0.0 < np.abs(near - exact).max() < 1e-2
