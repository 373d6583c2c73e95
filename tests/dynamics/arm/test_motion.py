"""What one arm is given, and the same arm at rest."""

import numpy as np
import pytest

from holdfast.dynamics.arm.free_dynamics import three_sweep
from holdfast.dynamics.arm.motion import at_rest
from tests.dynamics.problems import random_arm, random_motion


@pytest.mark.parametrize("seed", range(4))
def test_damping_is_off_the_torque(seed):
    """T = tau - damping qd."""
    given, motion = random_arm(seed), random_motion(seed)
    assert given.arm.damping.any()
    np.testing.assert_array_equal(motion.torque, given.tau - given.arm.damping * given.qd)


@pytest.mark.parametrize("seed", range(4))
def test_at_rest(seed):
    """At rest nothing moves by itself, and only what is applied accelerates; the posture stays."""
    motion = random_motion(seed)
    still = at_rest(motion)
    N = motion.arm.joint_count
    assert still.at is motion.at
    np.testing.assert_array_equal(still.torque, np.zeros(N))
    np.testing.assert_array_equal(still.tip_twist, np.zeros(6))
    np.testing.assert_array_equal(three_sweep(still, np.zeros(N), np.zeros(6)), np.zeros(N))
    twice = three_sweep(still, 2 * np.ones(N), np.zeros(6))
    np.testing.assert_allclose(twice, 2 * three_sweep(still, np.ones(N), np.zeros(6)), rtol=1e-13)
