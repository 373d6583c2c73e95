"""States, torques and results of another chain are refused by name, by every function of the dynamics."""

import numpy as np
import pytest

import holdfast as hf
from tests.dynamics.problems import random_problem

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
    with pytest.raises(hf.StateError, match="state: q: expected 14 joint positions"):
        OF_STATE[name](SHORT)


@pytest.mark.parametrize("name", OF_RESULT)
def test_result_of_another_chain(name):
    """The message names both shapes."""
    other = random_problem(1, grasps=("rigid",), joints=(6,), moving_base=False, extras=False)
    with pytest.raises(
        hf.StateError,
        match=r"expected one system of 2 arms with 14 joints|(base|grasp)_wrench: expected shape \(2, 6\)",
    ):
        OF_RESULT[name](hf.forward_dynamics(other.chain, other.state, other.tau))


def test_torques_of_another_chain():
    """Power needs a torque a joint."""
    with pytest.raises(hf.StateError, match="tau"):
        hf.dynamics.power(CHAIN, STATE, np.zeros(3), RESULT)
