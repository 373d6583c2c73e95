"""Four algorithms for one arm, one answer; each runs on scalars that know no branch."""

import numpy as np
import pytest

from holdfast.dynamics.arm.bias import bias_torque
from holdfast.dynamics.arm.free_dynamics import (
    articulated,
    composite,
    newton_euler_columns,
    three_sweep,
    tip_acceleration,
)
from holdfast.dynamics.arm.jacobian import jacobian
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.arm.motion import arm_motion
from holdfast.dynamics.arm.newton_euler import newton_euler
from holdfast.spatial.spatial_vector import shift_twist
from tests.dynamics.arm.moving import displaced
from tests.dynamics.problems import random_arm, random_motion, relative_gap
from tests.spatial.dual import duals, slopes_of, values_of

SOLVERS = [composite, newton_euler_columns, articulated, three_sweep]
solvers = pytest.mark.parametrize("solver", SOLVERS)
seeds = pytest.mark.parametrize("seed", range(12))


@seeds
@solvers
def test_equation_of_motion(seed, solver):
    """M qdd + C + J^T f = T, solved by NumPy."""
    motion = random_motion(seed)
    arm, at = motion.arm, motion.at
    f = 5 * np.random.default_rng(seed).normal(size=6)
    C, _ = bias_torque(arm, at, motion.bias.wrenches)
    expected = np.linalg.solve(mass_matrix(arm, at)[0], motion.torque - C - jacobian(arm, at).T @ f)
    assert relative_gap(solver(motion, motion.torque, f), expected) < 1e-12


@pytest.mark.parametrize("joints", [1, 30, 60])
def test_short_and_long_arms(joints):
    """One joint and sixty: the four still agree."""
    motion = random_motion(0, joints=joints, grasps="ball")
    answers = [solver(motion, motion.torque, np.ones(6)) for solver in SOLVERS]
    for answer in answers[1:]:
        assert relative_gap(answer, answers[0]) < 1e-11


@solvers
@pytest.mark.parametrize("seed", range(3))
def test_derivative(seed, solver):
    """Along any dq the torques stay what they are if qdd follows: exact, through every sweep."""
    given = random_arm(seed)
    dq = np.random.default_rng(seed).normal(size=len(given.q))
    motion = arm_motion(displaced(given, dq))
    f = np.arange(6.0)
    qdd = solver(motion, duals(arm_motion(given).torque, 0.0), f)
    torques, _ = newton_euler(motion, qdd, f)
    assert np.abs(slopes_of(qdd)).max() > 1
    assert np.abs(slopes_of(torques)).max() < 1e-9 * np.abs(slopes_of(qdd)).max()
    assert relative_gap(values_of(qdd), solver(arm_motion(given), arm_motion(given).torque, f)) < 1e-12


@seeds
def test_tip_acceleration(seed):
    """alpha(0) moved to the last link's origin is that link's acceleration: rigid body kinematics."""
    motion = random_motion(seed)
    qdd = np.random.default_rng(seed).normal(size=motion.arm.joint_count)
    alpha = tip_acceleration(motion, qdd)
    difference = alpha - tip_acceleration(motion, 0 * qdd)
    np.testing.assert_allclose(difference, jacobian(motion.arm, motion.at) @ qdd, atol=1e-12)
    # the same arm with its tip at the last origin
    bare = motion.arm.with_tip([1, 0, 0, 0, 0, 0, 0])
    given = random_arm(seed)
    at_origin = arm_motion(type(given)(**{**vars(given), "arm": bare}))
    reach, w = motion.at.reach[-1], motion.tip_twist[:3]
    carried = shift_twist(reach, tip_acceleration(at_origin, qdd))
    carried[3:] += np.cross(w, np.cross(w, reach))
    np.testing.assert_allclose(alpha, carried, atol=1e-11)
