"""The vocabulary of algorithm texts means the same on floats and on scalars of other kinds."""

import math

import numpy as np
import pytest

from holdfast.spatial import scalar
from tests.spatial.dual import Dual, duals, slopes_of


@pytest.mark.parametrize("x", [0.0, 1e-300, 0.3, 2.0, 1e5])
@pytest.mark.parametrize(
    ("name", "derivative"),
    [("sin", math.cos), ("cos", lambda x: -math.sin(x)), ("sqrt", lambda x: 0.5 / math.sqrt(x))],
)
def test_functions(name, derivative, x):
    """A float gives the C library's value; another scalar its own."""
    assert getattr(scalar, name)(x) == getattr(math, name)(x)
    if name != "sqrt" or x > 0:
        other = getattr(scalar, name)(Dual(x, 2.0))
        assert (other.value, other.slope) == (getattr(math, name)(x), 2.0 * derivative(x))


def test_root_of_a_negative():
    """A negative radicand is not a number: visible later, no exception inside an algorithm."""
    assert math.isnan(scalar.sqrt(-1e-300))
    assert math.isnan(scalar.sqrt(math.nan))


@pytest.mark.parametrize(("a", "b"), [(1.0, 2.0), (2.0, 1.0), (-0.5, -0.5)])
def test_selection(a, b):
    """Comparisons select without a branch, on any scalar."""
    assert scalar.maximum(a, b) == max(a, b)
    assert scalar.minimum(a, b) == min(a, b)
    assert scalar.maximum(Dual(a), Dual(b)).value == max(a, b)
    assert scalar.minimum(Dual(a), Dual(b)).value == min(a, b)
    assert scalar.where(a < b, "yes", "no") == scalar.where(Dual(a) < Dual(b), "yes", "no")


def test_arrays():
    """Numbers make float arrays, other scalars object arrays, nothing an empty array."""
    assert scalar.array([1.0, 2]).dtype == float
    mixed = scalar.array([1.0, Dual(2.0, 3.0)])
    assert mixed.dtype == object
    np.testing.assert_array_equal(slopes_of(mixed), [0.0, 3.0])
    assert scalar.concatenate([]).shape == (0,)
    np.testing.assert_array_equal(scalar.concatenate(x for x in ([1.0], [2.0, 3.0])), [1.0, 2.0, 3.0])
    assert scalar.concatenate([np.zeros(2), duals([1.0], 1.0)]).dtype == object
