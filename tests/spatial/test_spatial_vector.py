"""3-vectors; twists and wrenches are dual: what moves one forth moves the other back, power unchanged."""

import numpy as np
import pytest

from holdfast.dynamics.operators import phi
from holdfast.spatial.spatial_vector import centripetal, rotate, shift_twist, shift_wrench, unrotate
from holdfast.spatial.vector import cross, outer, skew
from tests.spatial.dual import duals, slopes_of
from tests.systems.random_parts import rotation

seeds = pytest.mark.parametrize("seed", range(5))


@seeds
def test_duality(seed):
    """<phi^T V, f> = <V, phi f>: power does not depend on the point."""
    rng = np.random.default_rng(seed)
    l, (V, f) = rng.normal(size=3), rng.normal(size=(2, 6))
    assert shift_twist(l, V) @ f == pytest.approx(V @ shift_wrench(l, f), abs=1e-14)


@seeds
def test_shifts_are_phi(seed):
    """phi f and phi^T V as cross products equal the 6x6 matrix of the paper; shifts one after the other add up."""
    rng = np.random.default_rng(seed)
    l, x = rng.normal(size=3), rng.normal(size=6)
    np.testing.assert_allclose(shift_wrench(l, x), phi(l) @ x, rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(shift_twist(l, x), phi(l).T @ x, rtol=1e-14, atol=1e-15)
    m = rng.normal(size=3)
    np.testing.assert_allclose(phi(l) @ phi(m), phi(l + m), atol=1e-14)


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


@seeds
def test_products(seed):
    """a x b, a~ b and a b^T are NumPy's, term by term."""
    rng = np.random.default_rng(seed)
    a, b, c = rng.normal(size=(3, 3))
    np.testing.assert_array_equal(cross(a, b), np.cross(a, b))
    np.testing.assert_array_equal(cross(a, a), np.zeros(3))
    np.testing.assert_allclose(skew(a) @ b, np.cross(a, b), rtol=1e-14, atol=1e-15)
    np.testing.assert_array_equal(skew(a).T, -skew(a))
    np.testing.assert_array_equal(outer(a, b[:2]), np.outer(a, b[:2]))
    jacobi = cross(a, cross(b, c)) + cross(b, cross(c, a)) + cross(c, cross(a, b))
    np.testing.assert_allclose(jacobi, np.zeros(3), atol=1e-14)


def test_product_rule():
    """(a x b)' = a' x b + a x b': the products run on other scalars."""
    rng = np.random.default_rng(1)
    a, b, da, db = rng.normal(size=(4, 3))
    turning = slopes_of(cross(duals(a, da), duals(b, db)))
    np.testing.assert_allclose(turning, np.cross(da, b) + np.cross(a, db), rtol=1e-14)
    np.testing.assert_allclose(slopes_of(skew(duals(a, da)) @ duals(b, db)), turning, rtol=1e-14)
