"""Many rotation vectors at once: those of `spatial.rotation`, near 0 and near pi as well."""

import numpy as np
import pytest

from holdfast.compiled import turns
from holdfast.spatial import rotation

ANGLES = (0.0, 1e-300, 1e-12, 0.9e-9, 1.1e-9, 1e-4, 0.5, 2.0, 3.0, *(np.pi - d for d in (1e-3, 1e-8, 1e-15)), np.pi)


def directions() -> np.ndarray:
    """Return the axes, their opposites, and random ones."""
    random = np.random.default_rng(0).normal(size=(40, 3))
    return np.concatenate([np.eye(3), -np.eye(3), random / np.linalg.norm(random, axis=1)[:, None]])


@pytest.mark.parametrize("angle", ANGLES)
def test_log(angle):
    """As the reference, to the last digits; a rotation by r has the logarithm r."""
    R = np.array([rotation.exp(angle * axis) for axis in directions()])
    found = turns.log(R)
    for r, each in zip(found, R, strict=True):
        np.testing.assert_allclose(r, rotation.log(each), rtol=4e-16, atol=4e-16 * angle)
    if angle < 3.1:
        np.testing.assert_allclose(found, angle * directions(), rtol=1e-14, atol=4e-16 * angle)
    else:
        np.testing.assert_allclose(np.linalg.norm(found, axis=-1), angle, atol=1e-14)
    np.testing.assert_array_equal(turns.log(R.reshape(2, -1, 3, 3)).reshape(-1, 3), found)
    np.testing.assert_array_equal([turns.log(each) for each in R], found)


@pytest.mark.parametrize("angle", ANGLES)
def test_align(angle):
    """As the reference, exactly opposed vectors included; the rotation does turn a to b."""
    random = np.random.default_rng(1)
    a = directions()
    across = np.cross(a, random.normal(size=a.shape))
    across /= np.linalg.norm(across, axis=1)[:, None]
    b = np.array([rotation.exp(angle * axis) @ v for axis, v in zip(across, a, strict=True)])
    if angle == np.pi:
        b = -a
    found = turns.align(a, b)
    for r, v, w in zip(found, a, b, strict=True):
        np.testing.assert_allclose(r, rotation.align(v, w), rtol=1e-15, atol=4e-16 * angle)
        np.testing.assert_allclose(rotation.exp(r) @ v, w, atol=2e-15)
    np.testing.assert_array_equal([turns.align(v, w) for v, w in zip(a, b, strict=True)], found)
    np.testing.assert_array_equal(turns.align(a, b[0])[0], found[0])


def test_not_a_number():
    """Not-a-number stays, without a warning."""
    R = np.array([np.eye(3), np.full((3, 3), np.nan)])
    with np.errstate(all="raise"):
        assert np.isnan(turns.log(R)).all(1).tolist() == [False, True]
        assert np.isnan(turns.align(R[:, 0], np.eye(3)[1])).all(1).tolist() == [False, True]
