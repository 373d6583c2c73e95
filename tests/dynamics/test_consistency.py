"""Whether a state holds its grasps, row by row; states, torques and results of another chain are refused by name."""

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest

import holdfast as hf
from holdfast import Inputs, Pose, State, forward_dynamics
from holdfast.dynamics import closure
from holdfast.dynamics.consistency import require_rates
from holdfast.errors import StateError
from holdfast.spatial import rotation
from tests.dynamics.problems import motion_of, pushed
from tests.systems.as_chain import Problem
from tests.systems.problems import CASES, largest_gaps, random_problem, stored

ROWS = {"rigid": (6, 6), "hinge": (5, 5), "softfinger": (3, 4), "ball": (3, 3)}
POSITIONS = {"rigid": range(6), "hinge": range(1, 6), "softfinger": range(3, 6), "ball": range(3, 6)}
OPTIONS = {"grasps": tuple(ROWS), "joints": (7, 6, 7, 6), "moving_base": True}


def with_velocity(p: Problem, qd) -> Problem:
    """Return the problem with other joint rates."""
    return replace(p, state=State(p.state.q, qd, p.state.object_pose, p.state.object_twist))


@pytest.mark.parametrize("name", CASES)
def test_stored_cases_are_closed(name):
    """Every stored state keeps its grasps to 1e-12; rows are 6/6, 5/5, 3/4 and 3/3."""
    p = stored(name)
    for arm, gap in closure(p.chain, p.state, p.inputs).items():
        assert (len(gap.position), len(gap.velocity)) == ROWS[p.chain.grasps[arm].kind]
        assert max(np.abs(gap.position).max(), np.abs(gap.velocity).max()) < 1e-12


@pytest.mark.parametrize("seed", range(3))
def test_displaced_object(seed):
    """A small displacement of the object shows in contact axes, row by row."""
    p = random_problem(seed, **OPTIONS)
    dx = 1e-5 * np.random.default_rng(seed).normal(size=6)
    for c, (name, gap) in zip(motion_of(p).contacts, closure(p.chain, pushed(p, dx), p.inputs).items(), strict=True):
        shift = dx[3:] + np.cross(dx[:3], c.offset)
        expected = np.r_[c.R.T @ dx[:3], c.R.T @ shift][list(POSITIONS[p.chain.grasps[name].kind])]
        np.testing.assert_allclose(gap.position, expected, atol=5e-9)


@pytest.mark.parametrize("seed", range(3))
def test_velocity_rows(seed):
    """A changed object twist shows as K A dV; base motion is part of the velocities."""
    p = random_problem(seed, **OPTIONS)
    dV = np.random.default_rng(seed).normal(size=6)
    state = State(p.state.q, p.state.qd, p.state.object_pose, p.state.object_twist + dV)
    gaps = closure(p.chain, state, p.inputs)
    for c, gap in zip(motion_of(p).contacts, gaps.values(), strict=True):
        at_contact = np.r_[dV[:3], dV[3:] + np.cross(dV[:3], c.offset)]
        np.testing.assert_allclose(gap.velocity, c.K @ at_contact, atol=1e-11)
    still = closure(p.chain, p.state, Inputs())
    assert max(np.abs(gap.velocity).max() for gap in still.values()) > 1e-2


@pytest.mark.parametrize("angle", [0.3, 2.0, np.pi])
def test_free_attitudes(angle):
    """A hinge may turn about its x axis by any angle, soft finger and ball about any: no position gap."""
    p = stored("mixed_4arm_all_types")
    turned = {}
    for name, grasp in p.chain.grasps.items():
        axis = np.eye(3)[0] if grasp.kind == "hinge" else np.array([0.6, 0.0, 0.8])
        turn = Pose(rotation.exp(angle * axis), np.zeros(3))
        turned[name] = p.chain.arms[name].with_tip(p.chain.arms[name].tip @ turn)
    chain = replace(p.chain, arms=turned)
    for name, gap in closure(chain, p.state, p.inputs).items():
        expected = angle if p.chain.grasps[name].kind == "rigid" else 0.0
        assert np.linalg.norm(gap.position) == pytest.approx(expected, abs=1e-7 if expected else 1e-12)


def test_hinge_the_wrong_way_round():
    """Opposed hinge axes are half a turn apart, not closed."""
    p = stored("hinge_2arm")
    arm = p.chain.arms["arm1"]
    turned = arm.with_tip(arm.tip @ Pose(np.diag([-1.0, -1.0, 1.0]), np.zeros(3)))
    chain = replace(p.chain, arms={**p.chain.arms, "arm1": turned})
    assert np.linalg.norm(closure(chain, p.state)["arm1"].position) == pytest.approx(np.pi, abs=1e-6)


@pytest.mark.parametrize("size", [2e-6, 1e-3])
def test_open_grasps_are_refused(size):
    """Forward dynamics refuses a broken state, naming the open arms only, their gaps and what to try."""
    p = stored("rigid_2arm_7R_gravity")
    state = State(p.state.q + size * np.eye(14)[0], p.state.qd, p.state.object_pose, p.state.object_twist)
    with pytest.raises(StateError, match=r"arm 'arm1': position gap .*; try holdfast\.close") as caught:
        forward_dynamics(p.chain, state, p.tau, inputs=p.inputs)
    assert "arm2" not in str(caught.value)
    forward_dynamics(p.chain, state, p.tau, inputs=p.inputs, check=False)


def test_tolerances():
    """1e-6 m or rad; velocities relative to the joint rates where these exceed 1."""
    p = stored("rigid_2arm_7R_gravity")
    dx = np.r_[np.zeros(3), 9e-7, 0, 0]
    forward_dynamics(p.chain, pushed(p, dx), p.tau)
    speed = np.linalg.norm(p.state.qd)
    assert speed > 2
    nudged = with_velocity(p, p.state.qd + np.eye(14)[0])
    unit = largest_gaps(closure(p.chain, nudged.state))[1]
    for size, holds in ((0.9, True), (1.1, False)):
        near = with_velocity(p, p.state.qd + size * 1e-6 * speed / unit * np.eye(14)[0])
        with nullcontext() if holds else pytest.raises(StateError, match="velocity gap"):
            near.solved()


def test_given_rates():
    """Relative rates W beside the velocities must be those they imply, to 1e-8."""
    p = stored("mixed_4arm_all_types")
    motion = motion_of(p)
    W = np.concatenate([c.W for c in motion.contacts])
    require_rates(motion, W + 5e-9)
    wrong = W.copy()
    wrong[p.chain.contact_freedoms["arm2"]] += 1e-3
    with pytest.raises(StateError, match=r"W is not what the velocities imply.*: arm 'arm2': gap 0\.001 rad/s\."):
        require_rates(motion, wrong)


P = random_problem(0, grasps=("rigid", "rigid"), joints=(7, 7), moving_base=False, extras=False)
CHAIN, STATE = P.chain, P.state
RESULT = hf.forward_dynamics(CHAIN, STATE, P.tau)
SHORT = hf.State(np.zeros(3), np.zeros(3), STATE.object_pose, STATE.object_twist)
ARM = CHAIN.names[0]

OF_STATE = {
    "centre_of_mass": lambda x: hf.dynamics.centre_of_mass(CHAIN, x),
    "close": lambda x: hf.close(CHAIN, x),
    "closure": lambda x: hf.dynamics.closure(CHAIN, x),
    "contact_attitudes": lambda x: hf.dynamics.contact_attitudes(CHAIN, x),
    "diagnose": lambda x: hf.diagnose(CHAIN, x),
    "forward_dynamics": lambda x: hf.forward_dynamics(CHAIN, x, P.tau),
    "grasp_margins": lambda x: hf.forces.grasp_margins(CHAIN, x, RESULT.grasp_wrench),
    "inverse_dynamics": lambda x: hf.inverse_dynamics(CHAIN, x, RESULT.qdd, RESULT.grasp_wrench),
    "joint_margins": lambda x: hf.forces.joint_margins(CHAIN, x, P.tau),
    "kinetic_energy": lambda x: hf.dynamics.kinetic_energy(CHAIN, x),
    "largest_margin": lambda x: hf.forces.largest_margin(CHAIN, x, RESULT),
    "last_joint_wrenches": lambda x: hf.forces.last_joint_wrenches(CHAIN, x, RESULT),
    "margin_range": lambda x: hf.forces.margin_range(CHAIN, x, RESULT),
    "momentum": lambda x: hf.dynamics.momentum(CHAIN, x),
    "momentum_rate": lambda x: hf.dynamics.momentum_rate(CHAIN, x, RESULT),
    "motion_basis": lambda x: hf.dynamics.motion_basis(CHAIN, x),
    "object_inertia": lambda x: hf.dynamics.object_inertia(CHAIN, x),
    "object_mobility": lambda x: hf.dynamics.object_mobility(CHAIN, x),
    "potential_energy": lambda x: hf.dynamics.potential_energy(CHAIN, x),
    "power": lambda x: hf.dynamics.power(CHAIN, x, P.tau, RESULT),
    "project": lambda x: hf.project(CHAIN, x),
    "project_velocity": lambda x: hf.dynamics.project_velocity(CHAIN, x),
    "split": lambda x: hf.forces.split(CHAIN, x, RESULT.grasp_wrench),
    "wrist_wrenches": lambda x: hf.forces.wrist_wrenches(CHAIN, x, RESULT),
}
OF_RESULT = {
    "largest_margin": lambda x: hf.forces.largest_margin(CHAIN, STATE, x),
    "last_joint_wrenches": lambda x: hf.forces.last_joint_wrenches(CHAIN, STATE, x),
    "margin_range": lambda x: hf.forces.margin_range(CHAIN, STATE, x),
    "momentum_rate": lambda x: hf.dynamics.momentum_rate(CHAIN, STATE, x),
    "power": lambda x: hf.dynamics.power(CHAIN, STATE, P.tau, x),
    "wrist_wrenches": lambda x: hf.forces.wrist_wrenches(CHAIN, STATE, x),
}


@pytest.mark.parametrize("name", OF_STATE)
def test_state_of_another_chain(name):
    """The message counts the joints of every arm."""
    OF_STATE[name](STATE)
    with pytest.raises(hf.errors.StateError, match="state: q: expected 14 joint positions"):
        OF_STATE[name](SHORT)


@pytest.mark.parametrize("name", OF_RESULT)
def test_result_of_another_chain(name):
    """The message names both shapes."""
    other = random_problem(1, grasps=("rigid",), joints=(6,), moving_base=False, extras=False)
    with pytest.raises(
        hf.errors.StateError,
        match=r"expected one system of 2 arms with 14 joints|(base|grasp)_wrench: expected shape \(2, 6\)",
    ):
        OF_RESULT[name](hf.forward_dynamics(other.chain, other.state, other.tau))


def test_torques_of_another_chain():
    """Power needs a torque a joint."""
    with pytest.raises(hf.errors.StateError, match="tau"):
        hf.dynamics.power(CHAIN, STATE, np.zeros(3), RESULT)
