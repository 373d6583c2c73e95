"""Products of 3-vectors."""

import numpy as np
import pytest

from holdfast.spatial.vector import cross, outer, skew
from tests.spatial.dual import duals, slopes_of


@pytest.mark.parametrize("seed", range(5))
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
