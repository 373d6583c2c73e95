"""The vocabulary of an algorithm text: functions that work on every kind of scalar.

A scalar is a `float`, or an object that brings its own `sin`, `cos`, `sqrt` and
`where` (an operation counter, a graph node). An algorithm written with these
functions, `+ - * /` and NumPy arrays runs on all of them; it must not branch on
a value with Python's `if`.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

Scalar = Any
Array = NDArray[Any]


def sin(x: Scalar) -> Scalar:
    """Return the sine of a scalar given in radians."""
    return x.sin() if hasattr(x, "sin") else math.sin(x)


def cos(x: Scalar) -> Scalar:
    """Return the cosine of a scalar given in radians."""
    return x.cos() if hasattr(x, "cos") else math.cos(x)


def sqrt(x: Scalar) -> Scalar:
    """Return the square root of a scalar; not a number if it is negative."""
    return x.sqrt() if hasattr(x, "sqrt") else math.sqrt(x) if x >= 0 else math.nan


def reciprocal(x: Scalar) -> Scalar:
    """Return 1 / x; infinite at zero."""
    return 1.0 / x if hasattr(x, "where") or x != 0 else math.inf


def where(condition: Scalar, a: Scalar, b: Scalar) -> Scalar:
    """Return `a` if the condition holds, else `b`; both are evaluated beforehand."""
    return condition.where(a, b) if hasattr(condition, "where") else (a if condition else b)


def select(condition: Scalar, a: Array, b: Array) -> Array:
    """Return the array `a` if the condition holds, else `b`, entry by entry."""
    if not hasattr(condition, "where"):
        return a if condition else b
    return np.reshape([condition.where(x, y) for x, y in zip(a.flat, b.flat, strict=True)], a.shape)


def maximum(a: Scalar, b: Scalar) -> Scalar:
    """Return the larger of two scalars."""
    return where(a > b, a, b)


def minimum(a: Scalar, b: Scalar) -> Scalar:
    """Return the smaller of two scalars."""
    return where(a < b, a, b)


def array(entries: Any) -> Array:
    """Return an array of the entries: float64 if all are numbers, else of objects."""
    return np.array(entries)


def concatenate(parts: Any) -> Array:
    """Return the 1-d arrays joined end to end; an empty list gives an empty array."""
    parts = list(parts)
    return np.concatenate(parts) if parts else np.zeros(0)
