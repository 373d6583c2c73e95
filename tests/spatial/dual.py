"""Dual numbers: a value and its exact derivative, a scalar that every traced function must accept.

A comparison gives no bool: an algorithm that branches on a value fails here as it would
when traced. `float()` is refused too, so that no derivative is lost in silence.
"""

from __future__ import annotations

import math

import numpy as np


class Dual:
    """x + x' e with e^2 = 0."""

    __slots__ = ("slope", "value")

    def __init__(self, value: float, slope: float = 0.0) -> None:
        self.value, self.slope = float(value), float(slope)

    def __add__(self, other):
        return _with(other, lambda y: Dual(self.value + y.value, self.slope + y.slope))

    def __sub__(self, other):
        return _with(other, lambda y: Dual(self.value - y.value, self.slope - y.slope))

    def __mul__(self, other):
        return _with(other, lambda y: Dual(self.value * y.value, self.slope * y.value + self.value * y.slope))

    def __truediv__(self, other):
        return _with(other, self._over)

    def __rtruediv__(self, other):
        return _with(other, lambda y: y._over(self))

    def _over(self, y: Dual) -> Dual:
        ratio = self.value / y.value
        return Dual(ratio, (self.slope - ratio * y.slope) / y.value)

    def __rsub__(self, other):
        return -self + other

    def __neg__(self):
        return Dual(-self.value, -self.slope)

    __radd__ = __add__
    __rmul__ = __mul__

    def __gt__(self, other):
        return _with(other, lambda y: Condition(self.value > y.value))

    def __lt__(self, other):
        return _with(other, lambda y: Condition(self.value < y.value))

    def __bool__(self):
        raise TypeError("an algorithm asks for the truth of a scalar")

    def sin(self):
        """Return the sine."""
        return Dual(math.sin(self.value), math.cos(self.value) * self.slope)

    def cos(self):
        """Return the cosine."""
        return Dual(math.cos(self.value), -math.sin(self.value) * self.slope)

    def sqrt(self):
        """Return the square root."""
        root = math.sqrt(self.value)
        return Dual(root, 0.5 * self.slope / root)

    def where(self, a, b):
        """Mark it as a scalar of its own kind; a number is no condition."""
        raise TypeError("a number is no condition")


class Condition:
    """The outcome of a comparison: it selects, and has no truth value."""

    def __init__(self, holds: bool) -> None:
        self.holds = holds

    def where(self, a, b):
        """Return a or b."""
        return a if self.holds else b

    def __bool__(self):
        raise TypeError("an algorithm branches on a value")


def _with(other, operation):
    if isinstance(other, Dual):
        return operation(other)
    if isinstance(other, int | float | np.number):
        return operation(Dual(other))
    return NotImplemented


def duals(values, slopes) -> np.ndarray:
    """Return an object array of dual numbers."""
    values, slopes = np.broadcast_arrays(np.asarray(values, dtype=float), np.asarray(slopes, dtype=float))
    result = np.empty(values.shape, dtype=object)
    for index in np.ndindex(*values.shape):
        result[index] = Dual(values[index], slopes[index])
    return result


def slopes_of(entries) -> np.ndarray:
    """Return the derivatives, 0 for plain numbers."""
    return np.vectorize(lambda x: getattr(x, "slope", 0.0), otypes=[float])(entries)


def values_of(entries) -> np.ndarray:
    """Return the values."""
    return np.vectorize(lambda x: float(getattr(x, "value", x)), otypes=[float])(entries)
