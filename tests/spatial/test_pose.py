"""Poses form a group that acts on points."""

import numpy as np
import pytest

from holdfast import ModelError, Pose
from tests.systems.random_parts import rotation


def random_pose(rng) -> Pose:
    """Return a pose within a metre or so."""
    return Pose(rotation(rng), rng.normal(size=3))


def point(pose: Pose, x) -> np.ndarray:
    """Return a point of the frame in the reference frame."""
    return pose.R @ x + pose.p


def assert_same(a: Pose, b: Pose) -> None:
    """Assert equality to rounding."""
    np.testing.assert_allclose(a.R, b.R, atol=1e-14)
    np.testing.assert_allclose(a.p, b.p, atol=1e-14)


@pytest.mark.parametrize("seed", range(5))
def test_group(seed):
    """Associative, with identity and inverse; (a b) x = a (b x)."""
    rng = np.random.default_rng(seed)
    a, b, c = (random_pose(rng) for _ in range(3))
    x = rng.normal(size=3)
    assert_same((a @ b) @ c, a @ (b @ c))
    assert_same(a @ a.inverse(), Pose.identity())
    assert_same(a.inverse() @ a, Pose.identity())
    assert_same(a @ Pose.identity(), a)
    assert_same((a @ b).inverse(), b.inverse() @ a.inverse())
    np.testing.assert_allclose(point(a @ b, x), point(a, point(b, x)), atol=1e-14)


@pytest.mark.parametrize("seed", range(5))
def test_seven_numbers(seed):
    """wxyz_xyz is unit quaternion with w >= 0, then position, and comes back."""
    pose = random_pose(np.random.default_rng(seed))
    seven = pose.wxyz_xyz
    assert seven.shape == (7,)
    assert seven[0] >= 0
    np.testing.assert_array_equal(seven[4:], pose.p)
    assert_same(Pose.from_wxyz_xyz(seven), pose)


def test_translation():
    """A translation moves the origin and keeps the axes."""
    there = Pose.translation(1, 2, 3)
    np.testing.assert_array_equal(there.R, np.eye(3))
    np.testing.assert_array_equal(there.p, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(there.wxyz_xyz, [1, 0, 0, 0, 1, 2, 3])


def test_lists():
    """Whatever is given, arrays are held; what is none is refused."""
    pose = Pose([[0, -1, 0], [1, 0, 0], [0, 0, 1]], (1, 2, 3))
    assert isinstance(pose.R, np.ndarray) and isinstance(pose.p, np.ndarray)
    assert_same(pose @ pose.inverse(), Pose.identity())
    assert isinstance(Pose.from_wxyz_xyz([1, 0, 0, 0, 1, 2, 3]).p, np.ndarray)
    for R, p, message in [
        (np.eye(3), [1, 2], r"pose: p: expected shape \(3,\), got shape \(2,\)"),
        ([1, [2]], np.zeros(3), r"pose: R: expected numbers of shape \(3, 3\), got \[1, \[2\]\]"),
    ]:
        with pytest.raises(ModelError, match=message):
            Pose(R, p)
