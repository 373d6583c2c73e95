"""Exponential and hyperbolic tangent in operations that every machine rounds the same, so that their bits are defined.

x = n log 2 + r with |r| <= log(2)/2, where log 2 is the sum of two doubles; e^r - 1 is the Taylor series; then the
result is multiplied by 2^n exactly, one factor per bit of n. Errors stay below one unit in the last place for e^x and
below three for tanh x.
"""

from __future__ import annotations

import math
from typing import Any

from holdfast.compiler.trigonometry import ROUNDER, polynomial

_LOG_2 = (0.6931471805599453, 2.3190468138462996e-17)  # log 2 rounded to a double, and the remainder
_LARGEST = 709.782712893384  # log of the largest double
_SMALLEST = -708.3964185322641  # log of the smallest normal double
_FLAT = 20.0  # above this tanh rounds to 1
_SERIES = tuple(1.0 / math.factorial(k) for k in range(2, 14))  # r^14 / 14! < 5e-18

Value = Any  # a node


def exp(x: Value) -> Value:
    """Return e^x; it is infinite where it overflows, and 0 where the result would be subnormal."""
    n, r, rest = _reduced(x)
    found = _times_power(1.0 + _less_one(r, rest), n)
    return (x > _LARGEST).where(math.inf, (x < _SMALLEST).where(0.0, found))


def tanh(x: Value) -> Value:
    """Return tanh x = t / (t + 2), t = e^2|x| - 1, with the sign of x; accurate to the last digits near zero too."""
    size = abs(x)
    n, r, rest = _reduced(2.0 * size)
    power = _times_power(1.0, n)
    t = power.fma(_less_one(r, rest), power - 1.0)
    found = (size > _FLAT).where(1.0, t / (t + 2.0))
    return (x < 0.0).where(-found, (size > 0.0).where(found, x))


def _reduced(x: Value) -> tuple[Value, Value, Value]:
    """Return n, r, and the correction to add to r."""
    n = x.fma(1.0 / _LOG_2[0], ROUNDER) - ROUNDER
    return n, n.fma(-_LOG_2[0], x), n * -_LOG_2[1]


def _less_one(r: Value, rest: Value) -> Value:
    """Return e^(r + rest) - 1."""
    series, square = polynomial(_SERIES, r), r * r
    rest = rest.fma(square.fma(series, r), rest)  # rest * e^r, to first order in rest
    return r + square.fma(series, rest)


def _times_power(x: Value, n: Value) -> Value:
    """Return x 2^n for an integer |n| < 1024 + 512, one power of two at a time, the largest first."""
    left, up = abs(n), n > 0.0
    for bit in (512.0, 512.0, 256.0, 128.0, 64.0, 32.0, 16.0, 8.0, 4.0, 2.0, 1.0):
        there = left >= bit
        x = x * there.where(up.where(2.0**bit, 2.0**-bit), 1.0)
        left = there.where(left - bit, left)
    return x
