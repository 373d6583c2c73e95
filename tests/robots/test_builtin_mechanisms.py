"""The platform and the hand: short arms that together can do everything."""

import numpy as np
import pytest

from holdfast import ClosedChain, ModelError, State, close
from holdfast.dynamics import closure, object_mobility
from holdfast.dynamics.rank import constraint_rank
from holdfast.robots import stewart_platform, three_finger_hand
from tests.systems.problems import largest_gaps


def at_rest(parts, height):
    """Return chain and closed state with all joints near the middle of their ranges."""
    chain = ClosedChain(*parts)
    q = np.concatenate([arm.position_limits.mean(axis=1) for arm in chain.arms.values()])
    return chain, close(chain, State(q, 0 * q, [1, 0, 0, 0, 0, 0, height]))


def test_platform_is_closed_at_zero():
    """All joints at 0 hold the platform level at 0.45 m, without any closing."""
    chain = ClosedChain(*stewart_platform())
    state = State(np.zeros(18), np.zeros(18), [1, 0, 0, 0, 0, 0, 0.45])
    assert largest_gaps(closure(chain, state))[0] < 1e-15


@pytest.mark.parametrize(("parts", "height"), [(stewart_platform(), 0.45), (three_finger_hand(), 0.08)])
def test_six_mobilities_all_of_the_object(parts, height):
    """Full rank, as many mobilities as the object has, and it can be moved along each."""
    chain, state = at_rest(parts, height)
    rank = constraint_rank(chain, state)
    assert rank == chain.constraint_row_count
    assert chain.joint_count + 6 + chain.contact_freedom_count - rank == 6
    mobility = object_mobility(chain, state)
    size = np.sqrt(np.diag(mobility))
    assert np.linalg.eigvalsh(mobility / np.outer(size, size))[0] > 1e-4


def test_fingers_press_inward():
    """Contact normals point at the ball's middle, from fingertips that lie outside."""
    for grasp in three_finger_hand().grasps.values():
        assert grasp.frame.R[:, 2] == pytest.approx(-grasp.frame.p / 0.035, abs=1e-15)
    chain, state = at_rest(three_finger_hand(), 0.08)
    assert state.object_pose[4:6] == pytest.approx([0, 0], abs=1e-12)
    low, high = np.concatenate([arm.position_limits for arm in chain.arms.values()]).T
    assert np.minimum(state.q - low, high - state.q).min() > 0.3


def test_sizes():
    """Payload and radius are the caller's; impossible ones are refused."""
    assert stewart_platform(payload=7.0).held_object.mass == 7.0
    assert three_finger_hand(radius=0.03).grasps["finger1"].frame.p == pytest.approx([0.03, 0, 0])
    for make in (lambda: stewart_platform(-1.0), lambda: three_finger_hand(mass=0.0)):
        with pytest.raises(ModelError, match="mass"):
            make()
