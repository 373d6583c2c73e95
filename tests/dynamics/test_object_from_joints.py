"""With rigid grasps the joints determine where the object is and how it moves (2.8)."""

import numpy as np
import pytest

from holdfast import MethodNotApplicable, StateError
from holdfast.dynamics import state_from_joints
from tests.systems.problems import CASES, random_problem, stored

RIGID = [name for name, case in CASES.items() if case["tags"]["all_rigid"]]


@pytest.mark.parametrize("name", RIGID)
def test_stored_states(name):
    """Pose and twist of the object in every stored case with rigid grasps."""
    p = stored(name)
    found = state_from_joints(p.chain, p.state.q, p.state.qd, inputs=p.inputs)
    np.testing.assert_allclose(found.object_frame.R, p.state.object_frame.R, atol=1e-11)
    np.testing.assert_allclose(found.object_pose[4:], p.state.object_pose[4:], atol=1e-11)
    np.testing.assert_allclose(found.object_twist, p.state.object_twist, atol=1e-10)
    np.testing.assert_array_equal(found.q, p.state.q)
    np.testing.assert_array_equal(found.qd, p.state.qd)


def test_other_arms_do_not_count():
    """Only arms that hold count; the first one's tip gives the pose."""
    p = random_problem(2, grasps="rigid", joints=(7, 6, 8))
    opened = p.chain.without_grasp("arm1")
    q = p.state.q + 0.7 * (np.arange(21) < 7)
    found = state_from_joints(opened, q, p.state.qd, inputs=p.inputs)
    np.testing.assert_allclose(found.object_pose, p.state.object_pose, atol=1e-12)


def test_least_squares_twist():
    """Joint rates that tear at the object: V(C) = (A^T A)^-1 A^T V(0), if the check is waived."""
    p = stored("rigid_2arm_7R_gravity")
    qd = p.state.qd + 0.1 * np.eye(14)[3]
    with pytest.raises(StateError, match="arm 'arm1'"):
        state_from_joints(p.chain, p.state.q, qd)
    found = state_from_joints(p.chain, p.state.q, qd, check=False)
    shift = found.object_twist - p.state.object_twist
    assert 1e-4 < np.abs(shift).max() < 0.1
    with pytest.raises(StateError, match="arm 'arm2': position gap"):
        state_from_joints(p.chain, p.state.q + 0.1 * np.eye(14)[10], p.state.qd)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("hinge_2arm", r"but 'arm1' is a hinge grasp; 'arm2' is a hinge grasp; give the object's pose"),
        ("mixed_4arm_all_types", r"but 'arm2' is a hinge grasp; 'arm3' is a ball grasp; 'arm4' is a softfinger grasp"),
    ],
)
def test_other_grasps(name, message):
    """Grasps with freedom leave the object's pose open: refused by name."""
    p = stored(name)
    with pytest.raises(MethodNotApplicable, match=message):
        state_from_joints(p.chain, p.state.q, p.state.qd)


def test_nobody_holds():
    """Without grasps nothing is known of the object."""
    p = stored("rigid_1arm_6R")
    with pytest.raises(MethodNotApplicable, match="needs rigid grasps, but there is none"):
        state_from_joints(p.chain.without_grasp("arm1"), p.state.q, p.state.qd)


@pytest.mark.parametrize(("q", "qd"), [(5, 6), (6, 5), (7, 7)])
def test_lengths(q, qd):
    """Wrong lengths are refused."""
    with pytest.raises(StateError, match="expected"):
        state_from_joints(stored("rigid_1arm_6R").chain, np.zeros(q), np.zeros(qd))
