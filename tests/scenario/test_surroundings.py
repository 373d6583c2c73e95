"""Swaying bases and pushes: derivatives against differences, and when they act."""

import numpy as np
import pytest

from holdfast.scenario.parts import Pushes, SwayingBase
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose

REST = Pose(rotation.exp(np.array([0.3, -0.2, 0.5])), np.array([1.0, 2.0, 3.0]))


def swaying(seed=0):
    rng = np.random.default_rng(seed)
    return SwayingBase(REST, rng.uniform(0.05, 0.4, 6), rng.uniform(0.3, 2, 6), rng.uniform(0, 6, 6), 0.4)


@pytest.mark.parametrize("t", [0.21, 0.39, 3.0])
def test_twist_and_acceleration_are_derivatives(t):
    """Central differences of pose and twist agree."""
    base, h = swaying(), 1e-4
    (before, twist_before, _), (here, twist, acceleration), (after, twist_after, _) = (
        base(x) for x in (t - h, t, t + h)
    )
    turning = rotation.log(after.R @ before.R.T) / (2 * h)
    assert twist[:3] == pytest.approx(turning, abs=1e-5)
    assert twist[3:] == pytest.approx((after.p - before.p) / (2 * h), abs=1e-5)
    assert acceleration == pytest.approx((twist_after - twist_before) / (2 * h), abs=1e-4)
    assert rotation.is_rotation(here.R, 1e-12)


def test_sets_out_from_rest():
    """At t = 0 the base stands where it stood, without velocity and acceleration, whatever the phases."""
    pose, twist, acceleration = swaying()(0.0)
    assert np.abs(pose.R - REST.R).max() < 1e-15
    assert pose.p == pytest.approx(REST.p)
    assert not twist.any()
    assert not acceleration.any()


def test_single_axes():
    """Each coordinate moves along or about its own world axis, about the base's origin."""
    for k in range(6):
        base = SwayingBase(REST, np.eye(6)[k], np.full(6, 0.7), np.zeros(6), 0.1)
        pose, twist, _ = base(0.2)
        x = np.sin(2 * np.pi * 0.7 * 0.2)
        turn = np.eye(6)[k][:3] * x
        assert np.abs(pose.R - rotation.exp(turn) @ REST.R).max() < 1e-15
        assert pose.p - REST.p == pytest.approx(np.eye(6)[k][3:] * x)
        assert np.count_nonzero(np.abs(twist) > 1e-12) == 1


def test_pushes():
    """They act from their begin up to their end, and add up."""
    pushes = Pushes(np.array([np.arange(6), np.ones(6)]), np.array([0.1, 0.2]), np.array([0.3, np.inf]))
    for t, expected in ((0.0, np.zeros(6)), (0.1, np.arange(6)), (0.25, np.arange(6) + 1), (0.3, np.ones(6))):
        assert np.array_equal(pushes(t).object_wrench, expected)
    assert pushes.breakpoints == [0.1, 0.2, 0.3]
