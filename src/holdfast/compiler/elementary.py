"""Elementary functions in operations that every machine rounds the same, so that their bits are defined.

Sine and cosine: x = n pi/2 + r with |r| <= pi/4, where pi/2 is the sum of three doubles (Cody and Waite) and r the sum
of two. For |x| <= 1e5 the error of r is below 2^-128, and no double there is closer to a multiple of pi/2 than 2^-60.
Then sin r and cos r are polynomials, which are multiplied by sine and cosine of n pi/2: 0, 1 or -1, one of them 0.

Exponential and hyperbolic tangent: x = n log 2 + r with |r| <= log(2)/2, where log 2 is the sum of two doubles;
e^r - 1 is the Taylor series; then the result is multiplied by 2^n exactly, one factor per bit of n.

Inverse tangent of a quotient: with t the smaller of |y| and |x| over the larger, atan t = atan c + atan u,
u = (t - c) / (1 + c t), for the nearest c of 0, 1/2 and 1. Then |u| <= 1/4, and atan u = u + u^3 A(u^2) with a
polynomial A; the rounding of u is corrected. Angles in other octants are multiples of pi/2 plus or minus that.

Errors stay below one unit in the last place, those of tanh below three.
"""

from __future__ import annotations

import math
from typing import Any

_Value = Any  # a node; functions of one argument share its reduction, because equal operations are one node

LARGEST_ARGUMENT = 1e5  # [rad]: as far as machine code takes angles

_TWO_OVER_PI = 0.6366197723675814
_HALF_PI = (1.5707963267948966, 6.123233995736766e-17)
# pi/2 to 145 bits. The second part has 37, so that its products with |n| < 2^16 are exact.
_QUARTER_TURN = (_HALF_PI[0], 6.123233995707727e-17, 2.9038559739793605e-28)
_ROUNDER = 1.5 * 2.0**52  # adding and subtracting it rounds x to an integer if |x| < 2^51

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


def sin(x: _Value) -> _Value:
    """Return the sine of x [rad]; NaN beyond 1e5 rad rather than a wrong value."""
    sine, cosine, of_r = _less_quarter_turns(x)
    return sine.fma(_cosine(*of_r), cosine * _sine(*of_r))


def cos(x: _Value) -> _Value:
    """Return the cosine of x [rad]; NaN beyond 1e5 rad rather than a wrong value."""
    sine, cosine, of_r = _less_quarter_turns(x)
    return cosine.fma(_cosine(*of_r), -(sine * _sine(*of_r)))


def _less_quarter_turns(x: _Value) -> tuple[_Value, _Value, tuple[_Value, _Value]]:
    """Return sine and cosine of n pi/2, and r with the correction to add to it."""
    n = x.fma(_TWO_OVER_PI, _ROUNDER) - _ROUNDER
    first = n.fma(-_QUARTER_TURN[0], x)  # exact, because it is a multiple of 2^-53 (for |x| > pi/4) below 1
    # first - n _QUARTER_TURN[1] is split into r + rest by Fast2Sum: the product is exact, and so are these differences,
    # because `first` is a multiple of the product's last bit.
    r = n.fma(-_QUARTER_TURN[1], first)
    rest = n.fma(-_QUARTER_TURN[1], first - r)
    rest = n.fma(-_QUARTER_TURN[2], rest)
    turns = (n.fma(0.25, _ROUNDER) - _ROUNDER).fma(-4.0, n)  # of a quarter: -2, -1, 0, 1 or 2
    cosine = 1.0 - abs(turns)
    return turns.fma(cosine, turns), cosine, ((abs(x) <= LARGEST_ARGUMENT).where(r, math.nan), rest)


def _sine(r: _Value, rest: _Value) -> _Value:
    """Return sin(r + rest) = r + (r^3 S(z) + rest cos r)."""
    z = r * r
    whole = z.fma(-0.5, 1.0)  # cos r, accurate enough for the small factor `rest`
    return r + (z * r).fma(_polynomial(_SINE, z), rest * whole)


def _cosine(r: _Value, rest: _Value) -> _Value:
    """Return cos(r + rest) = 1 - z/2 + (z^2 C(z) - r rest), corrected for the rounding of 1 - z/2."""
    z = r * r
    whole = z.fma(-0.5, 1.0)
    missing = z.fma(-0.5, 1.0 - whole)
    return whole + (z * z).fma(_polynomial(_COSINE, z), r.fma(-rest, missing))


_LOG_2 = (0.6931471805599453, 2.3190468138462996e-17)  # log 2 rounded to a double, and the remainder
_OVERFLOW = 709.782712893384  # log of the largest double
_UNDERFLOW = -708.3964185322641  # log of the smallest normal double
_TANH_IS_ONE = 20.0  # above this tanh rounds to 1
_EXPONENTIAL = tuple(1.0 / math.factorial(k) for k in range(2, 14))  # r^14 / 14! < 5e-18


def exp(x: _Value) -> _Value:
    """Return e^x; it is infinite where it overflows, and 0 where the result would be subnormal."""
    n, r, rest = _less_logs_of_2(x)
    found = _times_power(1.0 + _less_one(r, rest), n)
    return (x > _OVERFLOW).where(math.inf, (x < _UNDERFLOW).where(0.0, found))


def tanh(x: _Value) -> _Value:
    """Return tanh x = t / (t + 2), t = e^2|x| - 1, with the sign of x; accurate to the last digits near zero too."""
    size = abs(x)
    n, r, rest = _less_logs_of_2(2.0 * size)
    power = _times_power(1.0, n)
    t = power.fma(_less_one(r, rest), power - 1.0)
    found = (size > _TANH_IS_ONE).where(1.0, t / (t + 2.0))
    return (x < 0.0).where(-found, (size > 0.0).where(found, x))


def _less_logs_of_2(x: _Value) -> tuple[_Value, _Value, _Value]:
    """Return n, r, and the correction to add to r."""
    n = x.fma(1.0 / _LOG_2[0], _ROUNDER) - _ROUNDER
    return n, n.fma(-_LOG_2[0], x), n * -_LOG_2[1]


def _less_one(r: _Value, rest: _Value) -> _Value:
    """Return e^(r + rest) - 1."""
    series, square = _polynomial(_EXPONENTIAL, r), r * r
    rest = rest.fma(square.fma(series, r), rest)  # rest * e^r, to first order in rest
    return r + square.fma(series, rest)


def _times_power(x: _Value, n: _Value) -> _Value:
    """Return x 2^n for an integer |n| < 1024 + 512, one power of two at a time, the largest first."""
    left, up = abs(n), n > 0.0
    for bit in (512.0, 512.0, 256.0, 128.0, 64.0, 32.0, 16.0, 8.0, 4.0, 2.0, 1.0):
        there = left >= bit
        x = x * there.where(up.where(2.0**bit, 2.0**-bit), 1.0)
        left = there.where(left - bit, left)
    return x


_FROM_HALF, _FROM_ONE = 0.25, 0.75  # t above which c is 1/2, or 1
_HUGE, _SMALLER, _LARGER = 2.0**500, 2.0**-128, 2.0**128  # scales with which no sum overflows and no error underflows
# Angles as sums of two doubles.
_OF_HALF = (0.4636476090008061, 2.2698777452961687e-17)
_OF_ONE = (0.7853981633974483, 3.061616997868383e-17)
_PI = (3.141592653589793, 1.2246467991473532e-16)

# Coefficients of (atan u / u - 1) / z with z = u^2, interpolated at Chebyshev points of [0, 1/16] in 60 digits, then
# rounded. The relative error of the inverse tangent is 1.1e-18.
_INVERSE_TANGENT = (
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


def arctan2(y: _Value, x: _Value) -> _Value:
    """Return the angle of the point (x, y), in (-pi, pi] [rad].

    Zeros have no sign: the angle is 0 at the origin and pi wherever y = 0 and x < 0. It is not-a-number if an argument
    is infinite.
    """
    steep, left = abs(x) < abs(y), x < 0.0
    large, small = steep.where(abs(y), abs(x)), steep.where(abs(x), abs(y))
    scale = (large > _HUGE).where(_SMALLER, _LARGER)
    large, small = large * scale, small * scale
    above, far = small > _FROM_HALF * large, small > _FROM_ONE * large
    u, tail = _of_quotient(small, large, far.where(1.0, above.where(0.5, 0.0)))
    sign = steep.where(left.where(1.0, -1.0), left.where(-1.0, 1.0))
    begin = [steep.where(a, left.where(b, 0.0)) for a, b in zip(_HALF_PI[:2], _PI, strict=True)]
    angle = [far.where(a, above.where(b, 0.0)) for a, b in zip(_OF_ONE, _OF_HALF, strict=True)]
    # begin + sign angle + sign u, each sum with its rounding error (Fast2Sum: the first is zero or the larger)
    known = sign.fma(angle[0], begin[0])
    rest = sign.fma(angle[0], begin[0] - known) + sign.fma(angle[1], begin[1])
    turn = sign * u
    whole = known + turn
    value = whole + ((known - whole) + turn + sign.fma(tail, rest))
    return (y < 0.0).where(-value, value)


def _of_quotient(small: _Value, large: _Value, c: _Value) -> tuple[_Value, _Value]:
    """Return u and atan u - u for u = (small - c large) / (large + c small), corrected for the rounding of u."""
    numerator = c.fma(-large, small)  # exact
    denominator = c.fma(small, large)
    missing = c.fma(small, large - denominator)  # what rounding took from it
    denominator = (large > 0.0).where(denominator, 1.0)
    u = numerator / denominator
    rest = (u.fma(-denominator, numerator) - u * missing) / denominator
    z = u * u
    series = _polynomial(_INVERSE_TANGENT, z)
    return u, (z * u).fma(series, rest)


def _polynomial(coefficients: tuple[float, ...], z: _Value) -> _Value:
    """Return the polynomial by Horner's rule."""
    result = z.fma(coefficients[-1], coefficients[-2])
    for c in reversed(coefficients[:-2]):
        result = result.fma(z, c)
    return result
