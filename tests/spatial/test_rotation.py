"""Rotations: every representation says the same, near 0 and near pi as well."""

import math

import numpy as np
import pytest

from holdfast.compiler.interpret import interpret
from holdfast.compiler.trace import trace
from holdfast.spatial import rotation
from tests.systems.random_parts import rotation as random_rotation
from tests.systems.random_parts import rotation_vector_matrix, unit_vector

ANGLES = (
    0.0,
    1e-300,
    1e-12,
    1e-9,
    0.9999e-4,
    1.0001e-4,
    2e-4,
    1e-2,
    0.5,
    2.0,
    3.0,
    *(math.pi - d for d in (1e-3, 1e-8)),
)
AXES = [*np.eye(3), *-np.eye(3), *(unit_vector(np.random.default_rng(seed)) for seed in range(6))]
MANY_AXES = np.array([*AXES, *(unit_vector(np.random.default_rng(seed)) for seed in range(6, 40))])


@pytest.mark.parametrize("angle", [*ANGLES, math.pi])
def test_exp_is_rodrigues(angle):
    """exp(angle axis) = 1 + sin a~ + (1 - cos) a~ a~, and a rotation to the last digits."""
    for axis in AXES:
        R = rotation.exp(angle * axis)
        np.testing.assert_allclose(R, rotation_vector_matrix(angle * axis), atol=1e-15)
        assert rotation.is_rotation(R, 3e-15)  # 2.7e-15 at most about 20,000 random axes


@pytest.mark.parametrize("angle", [*ANGLES, math.pi - 1e-15, math.pi])
def test_log(angle):
    """log(exp(r)) = r, in relative precision down to the smallest angles; at pi both signs are right."""
    R = np.array([rotation.exp(angle * axis) for axis in MANY_AXES])
    found = np.array([rotation.log(each) for each in R])
    if angle < 3.1:
        np.testing.assert_allclose(found, angle * MANY_AXES, rtol=1e-14, atol=4e-16 * angle)
    else:
        np.testing.assert_allclose(np.linalg.norm(found, axis=-1), angle, atol=1e-14)
        np.testing.assert_allclose([rotation.exp(r) for r in found], R, atol=1e-14)
    program = trace(lambda R: (rotation.log(R),), [(3, 3)])
    traced = np.array([interpret(program, each)[0] for each in R[::5]])
    np.testing.assert_allclose(traced, found[::5], rtol=1e-14, atol=0.0)


@pytest.mark.parametrize("angle", [*ANGLES, math.pi])
def test_quaternion_round_trip(angle):
    """Matrix and unit quaternion agree both ways, w >= 0, whichever component is largest."""
    for axis in AXES:
        q = np.r_[math.cos(angle / 2), math.sin(angle / 2) * axis]
        R = rotation.from_quaternion(q)
        back = rotation.to_quaternion(R)
        assert back[0] >= 0
        assert abs(np.linalg.norm(back) - 1) < 1e-15
        assert min(np.abs(back - q).max(), np.abs(back + q).max()) < 1e-15
        np.testing.assert_allclose(rotation.from_quaternion(-q), R, atol=0)
        np.testing.assert_allclose(rotation.quaternion_exp(angle * axis), q, rtol=1e-15, atol=4e-16)


@pytest.mark.parametrize("seed", range(10))
def test_quaternion_product(seed):
    """The quaternion product is the product of the matrices, and keeps unit length."""
    rng = np.random.default_rng(seed)
    p, q = (rotation.normalised(x) for x in rng.normal(size=(2, 4)))
    product = rotation.quaternion_product(p, q)
    both = rotation.from_quaternion(p) @ rotation.from_quaternion(q)
    np.testing.assert_allclose(rotation.from_quaternion(product), both, atol=1e-15)
    assert np.linalg.norm(product) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize("pitch", [0.0, 0.7, -1.5, math.pi / 2 - 1e-6, 1e-6 - math.pi / 2])
def test_euler_round_trip(pitch):
    """Angles with |pitch| < pi/2 come back; R = Rz(yaw) Ry(pitch) Rx(roll)."""
    z, y, x = np.eye(3)[::-1]
    for yaw, roll in ((0.0, 0.0), (0.3, -2.9), (-3.1, 3.1), (1e-9, 1e-9)):
        R = rotation.from_euler_zyx(yaw, pitch, roll)
        expected = (
            rotation_vector_matrix(yaw * z) @ rotation_vector_matrix(pitch * y) @ rotation_vector_matrix(roll * x)
        )
        np.testing.assert_allclose(R, expected, atol=2e-15)
        digits = 1e-15 / math.cos(pitch)  # what the pitch leaves of yaw and roll
        np.testing.assert_allclose(rotation.to_euler_zyx(R), [yaw, pitch, roll], atol=4 * digits)


@pytest.mark.parametrize("pitch", [math.pi / 2, -math.pi / 2])
def test_euler_at_gimbal_lock(pitch):
    """At a pitch of +-pi/2 roll is 0 by choice and the rotation is kept."""
    for yaw, roll in ((0.0, 0.0), (0.4, 1.1), (-2.0, 3.0)):
        R = rotation.from_euler_zyx(yaw, pitch, roll)
        angles = rotation.to_euler_zyx(R)
        assert angles[2] == 0.0
        np.testing.assert_allclose(rotation.from_euler_zyx(*angles), R, atol=2e-12)


@pytest.mark.parametrize("seed", range(10))
def test_nearest(seed):
    """The polar factor of R (1 + small symmetric) is R: no rotation is nearer."""
    rng = np.random.default_rng(seed)
    R = random_rotation(rng)
    stretch = 1e-6 * rng.normal(size=(3, 3))
    np.testing.assert_allclose(rotation.nearest(R @ (np.eye(3) + stretch + stretch.T)), R, atol=1e-15)


def test_is_rotation():
    """Mirrors and stretches are none; the tolerance is on R^T R."""
    assert not rotation.is_rotation(np.diag([1.0, 1.0, -1.0]), 1e-6)
    stretched = np.diag([1.0, 1.0, 1.0 + 1e-7])
    assert rotation.is_rotation(stretched, 1e-6)
    assert not rotation.is_rotation(stretched, 1e-7)


@pytest.mark.parametrize("angle", [0.0, 1e-13, 1e-9, 0.4, 3.0, math.pi - 1e-9, math.pi - 1e-13, math.pi])
def test_align(angle):
    """The shortest turn that brings a to b: its length is their angle, its axis is normal to both."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        a = unit_vector(rng)
        across = np.cross(a, unit_vector(rng))
        b = math.cos(angle) * a + math.sin(angle) * across / np.linalg.norm(across)
        turn = rotation.align(a, b)
        assert np.linalg.norm(turn) == pytest.approx(angle, abs=2e-12)
        loose = 1e-15 * angle / max(math.sin(angle), 1e-12)  # digits that a x b leaves of the axis
        assert abs(turn @ a) <= 1e-15 + loose
        np.testing.assert_allclose(rotation.exp(turn) @ a, b, atol=2e-12 + 2 * loose)
    for axis in np.eye(3):
        np.testing.assert_allclose(rotation.exp(rotation.align(axis, -axis)) @ axis, -axis, atol=1e-15)


@pytest.mark.parametrize("angle", [*ANGLES, math.pi - 1e-15, math.pi])
def test_align_when_traced(angle):
    """The rotation does turn a to b, exactly opposed vectors included."""
    random = np.random.default_rng(1)
    a = MANY_AXES
    across = np.cross(a, random.normal(size=a.shape))
    across /= np.linalg.norm(across, axis=1)[:, None]
    b = np.array([rotation.exp(angle * axis) @ v for axis, v in zip(across, a, strict=True)])
    if angle == np.pi:
        b = -a
    program = trace(lambda a, b: (rotation.align(a, b),), [(3,), (3,)])
    for v, w in zip(a[::3], b[::3], strict=True):
        for r in (rotation.align(v, w), interpret(program, v, w)[0]):
            np.testing.assert_allclose(rotation.exp(r) @ v, w, atol=2e-15)


def test_not_a_number():
    """Not-a-number stays, without a warning."""
    R = np.full((3, 3), np.nan)
    with np.errstate(all="raise"):
        assert np.isnan(rotation.log(R)).all()
        assert np.isnan(rotation.align(R[0], np.eye(3)[1])).all()
