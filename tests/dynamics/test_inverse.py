"""Inverse dynamics of a chain: torques of given accelerations and grasp forces."""

import numpy as np
import pytest

from holdfast import StateError, forward_dynamics, inverse_dynamics
from holdfast.dynamics.closed.stacked import Stacked
from tests.dynamics.problems import CASES, motion_of, random_problem, relative_gap, stored

MIXED = {"grasps": ("rigid", None, "softfinger", "ball"), "joints": (6, 5, 7, 8), "moving_base": True}


@pytest.mark.parametrize("seed", range(8))
def test_torques_come_back(seed):
    """inverse(forward(tau)) = tau, damping, armature, wrenches, moving bases and free arms in."""
    p = random_problem(seed, **MIXED)
    result = forward_dynamics(p.chain, p.state, p.tau, inputs=p.inputs)
    tau = inverse_dynamics(p.chain, p.state, result.qdd, result.grasp_wrench, p.inputs)
    assert relative_gap(tau, p.tau) < 1e-11


@pytest.mark.parametrize("name", CASES)
def test_stored_answers(name):
    """The stored accelerations and forces ask for the stored torques."""
    p, expected = stored(name), CASES[name]["expected"]
    tau = inverse_dynamics(p.chain, p.state, np.concatenate(expected["qdd"]), expected["f"], p.inputs)
    size = np.abs(np.concatenate(expected["f"])).max()
    assert np.abs(tau - p.tau).max() < 1e-10 * max(1.0, size)


@pytest.mark.parametrize("seed", range(4))
def test_internal_forces_shift_torques_only(seed):
    """A squeeze u with A^T u = 0 adds J^T u to the torques, and moves nothing."""
    p = random_problem(seed, grasps="rigid", joints=(7, 6, 8))
    result = forward_dynamics(p.chain, p.state, p.tau, inputs=p.inputs)
    s = Stacked(motion_of(p))
    u = np.linalg.svd(s.A.T)[2][6:].T @ np.random.default_rng(seed).normal(size=12)
    squeezed = result.grasp_wrench + 20 * u.reshape(3, 6)
    tau = inverse_dynamics(p.chain, p.state, result.qdd, squeezed, p.inputs)
    assert relative_gap(tau - p.tau, 20 * s.J.T @ u) < 1e-9
    again = forward_dynamics(p.chain, p.state, tau, inputs=p.inputs)
    assert relative_gap(again.qdd, result.qdd) < 1e-9
    assert relative_gap(again.grasp_wrench, squeezed) < 1e-9


def test_refusals():
    """Wrong shapes, and a wrench on an arm that holds nothing, are refused by name."""
    p = random_problem(0, **MIXED)
    n, none = p.chain.joint_count, np.zeros((4, 6))
    with pytest.raises(StateError, match=r"qdd: expected shape \(26,\), got shape \(25,\)"):
        inverse_dynamics(p.chain, p.state, np.zeros(n - 1), none)
    with pytest.raises(StateError, match=r"grasp_wrench: expected shape \(4, 6\)"):
        inverse_dynamics(p.chain, p.state, np.zeros(n), none[:3])
    loaded = none.copy()
    loaded[1, 4] = 1.0
    with pytest.raises(StateError, match=r"grasp_wrench: arm 'arm2' holds nothing, expected zeros"):
        inverse_dynamics(p.chain, p.state, np.zeros(n), loaded)
