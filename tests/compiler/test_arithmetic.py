"""IEEE arithmetic on Python floats, against exact rationals and NumPy."""

import itertools
import math
from fractions import Fraction

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from holdfast.compiler import arithmetic

NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
SPECIAL = [0.0, -0.0, 1.0, -1.0, math.inf, -math.inf, math.nan, 5e-324, -1e308]


@given(NUMBERS, NUMBERS, NUMBERS)
def test_fma_is_rounded_once(a, b, c):
    """a b + c is the double nearest to the exact value."""
    exact = Fraction(a) * Fraction(b) + Fraction(c)
    try:
        assert arithmetic.fma(a, b, c) == float(exact)
    except OverflowError:
        assert arithmetic.fma(a, b, c) == (math.inf if exact > 0 else -math.inf)


def test_fma_keeps_what_a_product_loses():
    """The part that rounding the product drops."""
    a = 1.0 + 2.0**-30
    assert arithmetic.fma(a, a, -(a * a)) == 2.0**-60


def test_fma_of_special_values():
    """Infinities, zeros with their signs, NaN: as in extended precision, which holds these products exactly."""
    for a, b, c in itertools.product(SPECIAL, repeat=3):
        with np.errstate(all="ignore"):
            expected = float(np.longdouble(a) * np.longdouble(b) + np.longdouble(c))
        assert same(arithmetic.fma(a, b, c), expected), (a, b, c)


def test_division():
    """Division by zero is an infinity or NaN, never an exception."""
    for a, b in itertools.product(SPECIAL, repeat=2):
        with np.errstate(all="ignore"):
            expected = float(np.float64(a) / np.float64(b))
        assert same(arithmetic.divide(a, b), expected), (a, b)


def same(a: float, b: float) -> bool:
    """Return whether two numbers are the same, with the sign of a zero; NaN is NaN."""
    return (math.isnan(a) and math.isnan(b)) or (a, math.copysign(1.0, a)) == (b, math.copysign(1.0, b))


def test_roots():
    """The root of a negative number is NaN, of -0.0 it is -0.0."""
    assert math.isnan(arithmetic.sqrt(-1.0)) and math.isnan(arithmetic.sqrt(math.nan))
    assert math.copysign(1.0, arithmetic.sqrt(-0.0)) == -1.0
