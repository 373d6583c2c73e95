"""Sine and cosine in operations that every machine rounds the same, so that their bits are defined.

x = n pi/2 + r with |r| <= pi/4, where pi/2 is the sum of three doubles (Cody and Waite) and r the sum of two. For
|x| <= 1e5 the error of r is below 2^-140, and no double there is closer to a multiple of pi/2 than 2^-60. Then sin r
and cos r are polynomials; n mod 4 selects one of them and the sign. Errors stay below one unit in the last place.
"""

from __future__ import annotations

import math
from typing import Any

LARGEST_ARGUMENT = 1e5  # [rad]

_TWO_OVER_PI = 0.6366197723675814
# pi/2 to 160 bits: each part is the double nearest to the remainder of the parts before it.
_HALF_PI = (1.5707963267948966, 6.123233995736766e-17, -1.4973849048591698e-33)
ROUNDER = 1.5 * 2.0**52  # adding and subtracting it rounds x to an integer if |x| < 2^51

# Coefficients of (sin r / r - 1) / z and (cos r - 1 + z/2) / z^2 with z = r^2, interpolated at Chebyshev points of
# [0, (pi/4)^2] in 60 digits, then rounded. The relative errors of sin and cos are 2.0e-17 and 1.2e-18.
_SINE = (
    -0.16666666666666666,
    0.008333333333330946,
    -0.0001984126983675497,
    2.755731610068303e-06,
    -2.5051131455427946e-08,
    1.591810123027412e-10,
)
_COSINE = (
    0.041666666666666664,
    -0.0013888888888887395,
    2.4801587298763433e-05,
    -2.7557317270560326e-07,
    2.0876146024689747e-09,
    -1.1382614868556325e-11,
)

Value = Any  # a node; sin and cos of one argument share its reduction, because equal operations are one node


def sin(x: Value) -> Value:
    """Return the sine of x [rad]; NaN beyond 1e5 rad rather than a wrong value."""
    r, rest, quadrant = _reduced(x)
    odd = abs(abs(quadrant - 2.0) - 1.0) < 0.5  # 1, 3
    value = odd.where(_cosine(r, rest), _sine(r, rest))
    return (quadrant > 1.5).where(-value, value)


def cos(x: Value) -> Value:
    """Return the cosine of x [rad]; NaN beyond 1e5 rad rather than a wrong value."""
    r, rest, quadrant = _reduced(x)
    odd = abs(abs(quadrant - 2.0) - 1.0) < 0.5
    value = odd.where(_sine(r, rest), _cosine(r, rest))
    return (abs(quadrant - 1.5) < 1.0).where(-value, value)  # 1, 2


def _reduced(x: Value) -> tuple[Value, Value, Value]:
    """Return r, the correction to add to r, and n mod 4."""
    n = x.fma(_TWO_OVER_PI, ROUNDER) - ROUNDER
    first = n.fma(-_HALF_PI[0], x)  # exact, because it is a multiple of 2^-53 (for |x| > pi/4) below 1
    # first - n _HALF_PI[1] is split into r + rest: the product and its rounding error, then Fast2Sum, which is exact
    # because `first` is a multiple of the product's last bit.
    product = n * _HALF_PI[1]
    product_error = n.fma(_HALF_PI[1], -product)
    r = first - product
    rest = (first - r) - product
    rest = n.fma(-_HALF_PI[2], rest - product_error)
    quarter = n.fma(0.25, -0.375) + ROUNDER - ROUNDER  # floor(n / 4)
    quadrant = quarter.fma(-4.0, n)
    return (abs(x) <= LARGEST_ARGUMENT).where(r, math.nan), rest, quadrant


def _sine(r: Value, rest: Value) -> Value:
    """Return sin(r + rest) = r + (r^3 S(z) + rest cos r)."""
    z = r * r
    half = z.fma(-0.5, 1.0)  # cos r, accurate enough for the small factor `rest`
    return r + (z * r).fma(polynomial(_SINE, z), rest * half)


def _cosine(r: Value, rest: Value) -> Value:
    """Return cos(r + rest) = 1 - z/2 + (z^2 C(z) - r rest), corrected for the rounding of 1 - z/2."""
    z = r * r
    half = 0.5 * z
    whole = 1.0 - half
    return whole + (((1.0 - whole) - half) + (z * z).fma(polynomial(_COSINE, z), -(r * rest)))


def polynomial(coefficients: tuple[float, ...], z: Value) -> Value:
    """Return the polynomial by Horner's rule."""
    result = z.fma(coefficients[-1], coefficients[-2])
    for c in reversed(coefficients[:-2]):
        result = result.fma(z, c)
    return result
