"""The rest-to-rest path is smooth, rests at its ends, and its derivatives are its derivatives."""

import numpy as np
import pytest

from holdfast import ModelError, Pose
from holdfast.control.paths import RestToRest, quintic
from holdfast.spatial import rotation

START = Pose(rotation.exp(np.array([0.3, -0.2, 1.0])), np.array([0.1, 0.2, 0.3]))
PATH = RestToRest(START, np.array([0.0, 0.1, 0.2]), np.array([0.4, 0.0, -0.3]), begin=0.2, duration=1.6)


def test_quintic_is_exact_at_the_ends():
    """s goes from 0 to 1 with both derivatives zero, and stays."""
    for x in (-3.0, 0.0):
        assert quintic(x) == (0.0, 0.0, 0.0)
    for x in (1.0, 7.0):
        assert quintic(x) == (1.0, 0.0, 0.0)
    assert quintic(0.5) == pytest.approx((0.5, 1.875, 0.0))


@pytest.mark.parametrize("t", [0.0, 0.2, 0.21, 0.7, 1.5, 1.79, 2.5])
def test_twist_and_acceleration_are_derivatives(t):
    """Central differences of pose and twist."""
    h = 1e-5
    before, now, after = PATH.at(t - h), PATH.at(t), PATH.at(t + h)
    turning = rotation.log(after.pose.R @ before.pose.R.T) / (2 * h)
    assert np.r_[turning, (after.pose.p - before.pose.p) / (2 * h)] == pytest.approx(now.twist, abs=1e-9)
    assert (after.twist - before.twist) / (2 * h) == pytest.approx(now.acceleration, abs=2e-4)


def test_ends():
    """It begins at the start pose and ends displaced and turned."""
    assert pytest.approx(START.R) == PATH.at(0.1).pose.R
    end = PATH.at(1.8).pose
    assert end.p == pytest.approx(START.p + PATH.displacement)
    assert rotation.log(end.R @ START.R.T) == pytest.approx(PATH.turn)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"duration": 0.0}, "path: duration: expected > 0"),
        ({"begin": -0.1}, "path: begin: expected >= 0"),
        ({"turn": np.zeros(2)}, "path: turn: expected shape (3,)"),
        ({"displacement": np.full(3, np.inf)}, "path: displacement: expected finite"),
    ],
)
def test_refused(change, message):
    """An impossible path is refused by name."""
    with pytest.raises(ModelError) as caught:
        RestToRest(**{"start": START} | change)
    assert message in str(caught.value)
