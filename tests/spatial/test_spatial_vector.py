"""Twists and wrenches are dual: what moves one forth moves the other back, power unchanged."""

import numpy as np
import pytest

from holdfast.dynamics.operators import phi
from holdfast.spatial.spatial_vector import centripetal, rotate, shift_twist, shift_wrench, unrotate
from tests.systems.random_parts import rotation

seeds = pytest.mark.parametrize("seed", range(10))


@seeds
def test_duality(seed):
    """<phi^T V, f> = <V, phi f>: power does not depend on the point."""
    rng = np.random.default_rng(seed)
    l, (V, f) = rng.normal(size=3), rng.normal(size=(2, 6))
    assert shift_twist(l, V) @ f == pytest.approx(V @ shift_wrench(l, f), abs=1e-14)


@seeds
def test_shifts_are_phi(seed):
    """phi f and phi^T V as cross products equal the 6x6 matrix of the paper."""
    rng = np.random.default_rng(seed)
    l, x = rng.normal(size=3), rng.normal(size=6)
    np.testing.assert_allclose(shift_wrench(l, x), phi(l) @ x, rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(shift_twist(l, x), phi(l).T @ x, rtol=1e-14, atol=1e-15)


@seeds
def test_shifts_compose(seed):
    """phi(a, b) phi(b, c) = phi(a, c), and phi(b, a) undoes phi(a, b)."""
    rng = np.random.default_rng(seed)
    l, m, x = rng.normal(size=3), rng.normal(size=3), rng.normal(size=6)
    np.testing.assert_allclose(shift_wrench(l, shift_wrench(m, x)), shift_wrench(l + m, x), atol=1e-14)
    np.testing.assert_allclose(shift_twist(m, shift_twist(l, x)), shift_twist(l + m, x), atol=1e-14)
    np.testing.assert_allclose(shift_wrench(-l, shift_wrench(l, x)), x, atol=1e-14)


@seeds
def test_axes(seed):
    """Turning the axes keeps power and commutes with shifting; unrotate undoes rotate."""
    rng = np.random.default_rng(seed)
    R, l, (V, f) = rotation(rng), rng.normal(size=3), rng.normal(size=(2, 6))
    assert rotate(R, V) @ rotate(R, f) == pytest.approx(V @ f, abs=1e-14)
    np.testing.assert_allclose(unrotate(R, rotate(R, V)), V, atol=1e-14)
    np.testing.assert_allclose(rotate(R, shift_twist(l, V)), shift_twist(R @ l, rotate(R, V)), atol=1e-14)
    np.testing.assert_allclose(rotate(R, shift_wrench(l, f)), shift_wrench(R @ l, rotate(R, f)), atol=1e-14)


@seeds
def test_centripetal(seed):
    """w x (w x l) points to the axis, with |w|^2 times the distance from it."""
    w, l = np.random.default_rng(seed).normal(size=(2, 3))
    across = l - (l @ w) / (w @ w) * w
    np.testing.assert_allclose(centripetal(w, l), -(w @ w) * across, atol=1e-14 * (w @ w))
