"""Poses form a group that acts on points."""

import numpy as np
import pytest

from holdfast import Pose, contact_frame
from holdfast.errors import ModelError
from holdfast.spatial.rotation import exp
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


def test_rpy():
    """Turned about the fixed x, then y, then z; right angles are exact."""
    x, y, z = np.eye(3)
    R = exp(0.3 * z) @ exp(-0.2 * y) @ exp(0.1 * x)
    assert_same(Pose.from_rpy(0.1, -0.2, 0.3, [1.0, 2.0, 3.0]), Pose(R, [1.0, 2.0, 3.0]))
    np.testing.assert_array_equal(Pose.from_rpy(np.pi, 0.0, np.pi / 2).R, [[0, 1, 0], [1, 0, 0], [0, 0, -1]])


def test_other_orders():
    """A scalar that is last, and a homogeneous matrix, give the same pose."""
    pose = random_pose(np.random.default_rng(1))
    w, x, y, z, *p = pose.wxyz_xyz
    assert_same(Pose.from_xyzw([x, y, z, w], p), pose)
    T = np.block([[pose.R, pose.p[:, None]], [np.zeros(3), 1.0]])
    assert_same(Pose.from_matrix(T), pose)
    with pytest.raises(ModelError, match=r"bottom row 0 0 0 1, got .*try the transpose"):
        Pose.from_matrix(T.T)


@pytest.mark.parametrize("seed", range(3))
def test_looking(seed):
    """The target is straight ahead; x leans to the hint and never away; axes are orthonormal."""
    rng = np.random.default_rng(seed)
    origin, target, hint = rng.normal(size=(3, 3))
    pose = Pose.looking(origin, at=target, x=hint)
    np.testing.assert_allclose(point(pose.inverse(), target), [0, 0, np.linalg.norm(target - origin)], atol=1e-14)
    assert hint @ pose.R[:, 0] > 0 and abs(hint @ pose.R[:, 1]) < 1e-14
    assert_same(pose, Pose.looking(origin, z=1e-9 * (target - origin), x=1e9 * hint))
    camera = Pose.looking(origin, at=target)
    assert abs(camera.R[2, 0]) < 1e-15 and camera.R[2, 1] < 0
    nearly = Pose.looking(z=[0, 0, 1], x=[2e-6, 1e-6, 1.0])
    np.testing.assert_allclose(nearly.R.T @ nearly.R, np.eye(3), atol=1e-14)


def test_looking_up_and_down():
    """Where there is no right and down, x is the reference frame's, also a rounding beside it."""
    for z in ([0, 0, 2.0], [0, 0, -1.0], [1e-9, -1e-9, 1.0]):
        np.testing.assert_allclose(Pose.looking(z=z).R[:, 0], [1, 0, 0], atol=2e-9)


def test_looking_refuses():
    """No direction, two of them, none to tell x from, a point at the origin."""
    for given, message in (
        ({}, "one of at and z, got neither"),
        ({"at": [1, 0, 0], "z": [1, 0, 0]}, "one of at and z, got both"),
        ({"at": [0, 0, 0]}, "at - origin: expected a direction"),
        ({"z": [1, 0, 0], "x": [-2, 0, 0]}, "x: expected a direction across z"),
        ({"z": [1, 0, 0], "x": [0, 0, 0]}, "x: expected a direction, got a vector of length zero"),
    ):
        with pytest.raises(ModelError, match=message):
            Pose.looking(**given)


def test_contact_frame():
    """On a box's end face: z into it, x to the right, y down; what README wrote as a quaternion before."""
    left = contact_frame([-0.15, 0, 0], into=[2, 0, 0])
    np.testing.assert_array_equal(left.R, np.column_stack([[0, -1, 0], [0, 0, -1], [1, 0, 0]]))
    np.testing.assert_array_equal(left.R, Pose.from_wxyz_xyz([0.5, -0.5, 0.5, -0.5, -0.15, 0, 0]).R)
    np.testing.assert_array_equal(contact_frame([0, 0, 1], [0, 0, -1], x=[0, 1, 0]).R[:, 0], [0, 1, 0])
