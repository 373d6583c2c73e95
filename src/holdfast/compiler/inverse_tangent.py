"""Inverse tangent of a quotient in operations that every machine rounds the same, so that its bits are defined.

With t the smaller of |y| and |x| over the larger, atan t = atan c + atan u, u = (t - c) / (1 + c t), for the nearest c
of 0, 1/2 and 1. Then |u| <= 1/4, and atan u = u + u^3 A(u^2) with a polynomial A; the rounding of u is corrected.
Angles in other octants are multiples of pi/2 plus or minus that. Errors stay below one unit in the last place.
"""

from __future__ import annotations

from typing import Any

from holdfast.compiler.trigonometry import polynomial

_FROM_HALF, _FROM_ONE = 0.25, 0.75  # t above which c is 1/2, or 1
_LARGE, _SMALLER, _LARGER = 2.0**500, 2.0**-128, 2.0**128  # scales with which no sum overflows and no error underflows
# Angles as sums of two doubles.
_OF_HALF = (0.4636476090008061, 2.2698777452961687e-17)
_OF_ONE = (0.7853981633974483, 3.061616997868383e-17)
_HALF_PI = (1.5707963267948966, 6.123233995736766e-17)
_PI = (3.141592653589793, 1.2246467991473532e-16)

# Coefficients of (atan u / u - 1) / z with z = u^2, interpolated at Chebyshev points of [0, 1/16] in 60 digits, then
# rounded. The relative error of the inverse tangent is 1.1e-18.
_SERIES = (
    -0.3333333333333333,
    0.19999999999998933,
    -0.14285714285258203,
    0.11111111035943566,
    -0.09090902872006794,
    0.07692017767847607,
    -0.0665868518994893,
    0.05752970946523289,
    -0.04103326768210488,
)

Value = Any  # a node


def arctan2(y: Value, x: Value) -> Value:
    """Return the angle of the point (x, y), in (-pi, pi] [rad].

    Zeros have no sign: the angle is 0 at the origin and pi wherever y = 0 and x < 0. It is not-a-number if an argument
    is infinite.
    """
    steep, left = abs(x) < abs(y), x < 0.0
    large, small = steep.where(abs(y), abs(x)), steep.where(abs(x), abs(y))
    scale = (large > _LARGE).where(_SMALLER, _LARGER)
    large, small = large * scale, small * scale
    above, far = small > _FROM_HALF * large, small > _FROM_ONE * large
    u, tail = _of_quotient(small, large, far.where(1.0, above.where(0.5, 0.0)))
    sign = steep.where(left.where(1.0, -1.0), left.where(-1.0, 1.0))
    begin = [steep.where(a, left.where(b, 0.0)) for a, b in zip(_HALF_PI, _PI, strict=True)]
    angle = [far.where(a, above.where(b, 0.0)) for a, b in zip(_OF_ONE, _OF_HALF, strict=True)]
    # begin + sign angle + sign u, each sum with its rounding error (Fast2Sum: the first is zero or the larger)
    known = sign.fma(angle[0], begin[0])
    rest = sign.fma(angle[0], begin[0] - known) + sign.fma(angle[1], begin[1])
    turn = sign * u
    whole = known + turn
    value = whole + ((known - whole) + turn + sign.fma(tail, rest))
    return (y < 0.0).where(-value, value)


def _of_quotient(small: Value, large: Value, c: Value) -> tuple[Value, Value]:
    """Return u and atan u - u for u = (small - c large) / (large + c small), corrected for the rounding of u."""
    numerator = c.fma(-large, small)  # exact
    denominator = c.fma(small, large)
    missing = c.fma(small, large - denominator)  # what rounding took from it
    denominator = (large > 0.0).where(denominator, 1.0)
    u = numerator / denominator
    rest = (u.fma(-denominator, numerator) - u * missing) / denominator
    z = u * u
    series = polynomial(_SERIES, z)
    return u, (z * u).fma(series, rest)
