"""Rotation vectors of many rotations, near 0 and near pi as well; traced, they have the same digits."""

import numpy as np
import pytest

from holdfast.compiler.interpret import interpret
from holdfast.compiler.trace import trace
from holdfast.spatial import rotation

ANGLES = (0.0, 1e-300, 1e-12, 0.9e-9, 1.1e-9, 1e-4, 0.5, 2.0, 3.0, *(np.pi - d for d in (1e-3, 1e-8, 1e-15)), np.pi)


def directions() -> np.ndarray:
    """Return the axes, their opposites, and random ones."""
    random = np.random.default_rng(0).normal(size=(40, 3))
    return np.concatenate([np.eye(3), -np.eye(3), random / np.linalg.norm(random, axis=1)[:, None]])


@pytest.mark.parametrize("angle", ANGLES)
def test_log(angle):
    """A rotation by r has the logarithm r."""
    R = np.array([rotation.exp(angle * axis) for axis in directions()])
    found = np.array([rotation.log(each) for each in R])
    if angle < 3.1:
        np.testing.assert_allclose(found, angle * directions(), rtol=1e-14, atol=4e-16 * angle)
    else:
        np.testing.assert_allclose(np.linalg.norm(found, axis=-1), angle, atol=1e-14)
    program = trace(lambda R: (rotation.log(R),), [(3, 3)])
    traced = np.array([interpret(program, each)[0] for each in R[::5]])
    np.testing.assert_allclose(traced, found[::5], rtol=1e-14, atol=0.0)


@pytest.mark.parametrize("angle", ANGLES)
def test_align(angle):
    """The rotation does turn a to b, exactly opposed vectors included."""
    random = np.random.default_rng(1)
    a = directions()
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
