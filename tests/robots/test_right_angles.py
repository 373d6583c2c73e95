"""Right angles that were written with too few digits."""

import numpy as np

from holdfast.robots import panda
from holdfast.robots.right_angles import with_right_angles
from holdfast.robots.urdf import load_urdf
from tests.robots.arm_dynamics import mass_jacobian_bias
from tests.robots.two_armed import TWO_ARMED

ARM = {"base": "torso", "tip": "left_grasp", "lock_others": True}


def test_near_right_angles_become_exact():
    """`1.57079632679` is 5e-12 off; the entries become 0 and 1, and the dynamics move by no more than that."""
    arm = load_urdf(TWO_ARMED.replace("1.5707963267948966", "1.57079632679"), **ARM)
    assert 0 < arm.joints[0].placement.R[1, 1] < 1e-11
    exact = with_right_angles(arm)
    assert set(np.abs(exact.joints[0].placement.R).ravel()) == {0.0, 1.0}
    q, qd = np.array([0.3, 0.7, 0.1]), np.array([1.0, -2.0, 0.5])
    for a, b in zip(mass_jacobian_bias(arm, q, qd), mass_jacobian_bias(exact, q, qd), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-10 * np.abs(a).max())


def test_other_angles_stay():
    """What is no right angle, or one already, is not touched."""
    arm = load_urdf(TWO_ARMED.replace("1.5707963267948966", "1.5708"), **ARM)
    for given in (arm, panda()):
        for before, after in zip(given.joints, with_right_angles(given).joints, strict=True):
            np.testing.assert_array_equal(before.placement.R, after.placement.R)
