"""Block operations on symmetric 6x6 matrices equal the dense products they stand for."""

import numpy as np
import pytest

from holdfast.dynamics.operators import phi
from holdfast.spatial.symmetric import Symmetric6, mirrored, symmetric6, zero6
from tests.spatial.dual import duals, slopes_of
from tests.systems.random_parts import rotation

seeds = pytest.mark.parametrize("seed", range(4))


def drawn(seed: int) -> tuple[np.random.Generator, np.ndarray, Symmetric6]:
    """Return a random symmetric matrix, dense and in blocks."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(6, 6))
    X = X + X.T
    return rng, X, symmetric6(X)


def assert_is(blocks: Symmetric6, dense) -> None:
    """Assert equality, and symmetry to the last bit."""
    got = blocks.dense()
    np.testing.assert_allclose(got, dense, rtol=1e-13, atol=1e-13)
    np.testing.assert_array_equal(got, got.T)


@seeds
def test_blocks(seed):
    """Dense matrix and blocks are the same numbers; products and sums agree."""
    rng, X, blocks = drawn(seed)
    x = rng.normal(size=6)
    np.testing.assert_array_equal(blocks.dense(), X)
    np.testing.assert_allclose(blocks.apply(x), X @ x, rtol=1e-13, atol=1e-14)
    assert_is(blocks.plus(zero6()), X)
    assert_is(blocks.plus(blocks), 2 * X)


@seeds
def test_outer_products(seed):
    """X + u s^T with s along u, and X + u s^T + s u^T for any s."""
    rng, X, blocks = drawn(seed)
    u, s = rng.normal(size=(2, 6))
    assert_is(blocks.plus_outer(u, -0.3 * u), X - 0.3 * np.outer(u, u))
    assert_is(blocks.plus_symmetric_outer(u, s), X + np.outer(u, s) + np.outer(s, u))


@seeds
def test_axes_and_points(seed):
    """R X R^T, phi X phi^T and phi^T X phi, symmetric to the last bit."""
    rng, X, blocks = drawn(seed)
    R, l = rotation(rng), rng.normal(size=3)
    both = np.kron(np.eye(2), R)
    assert_is(blocks.rotated(R), both @ X @ both.T)
    assert_is(blocks.inertia_shifted(l), phi(l) @ X @ phi(l).T)
    assert_is(blocks.mobility_shifted(l), phi(l).T @ X @ phi(l))


def test_mirrored():
    """The upper triangle decides."""
    np.testing.assert_array_equal(mirrored(np.array([[1.0, 2.0], [7.0, 3.0]])), [[1.0, 2.0], [2.0, 3.0]])


def test_other_scalars():
    """Shifts differentiate like the dense product: blocks run on other scalars."""
    rng, X, _ = drawn(3)
    dX, l, dl = rng.normal(size=(6, 6)), rng.normal(size=3), rng.normal(size=3)
    dX = dX + dX.T
    blocks = symmetric6(duals(X, dX))
    dphi = phi(dl) - np.eye(6)
    expected = dphi.T @ X @ phi(l) + phi(l).T @ dX @ phi(l) + phi(l).T @ X @ dphi
    np.testing.assert_allclose(slopes_of(blocks.mobility_shifted(duals(l, dl)).dense()), expected, atol=1e-13)
