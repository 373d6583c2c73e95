"""A scalar with exact derivatives along one direction or many: every traced function must accept it.

Values and tangents are float64, or numbers of many digits. A comparison gives no bool: an algorithm that branches on a
value fails here as it would when traced. `float()` is refused too, so that no derivative is lost in silence.
"""

from __future__ import annotations

import math
from types import ModuleType

import numpy as np


class Dual:
    """x + sum of x_k e_k with e_j e_k = 0.

    Attributes:
        value: x.
        tangent: (directions,) x_k; a number if there is one direction.
    """

    __slots__ = ("tangent", "value")

    def __init__(self, value, tangent: np.ndarray | float = 0.0) -> None:
        self.value, self.tangent = value, tangent

    def __add__(self, other):
        if isinstance(other, Dual):
            return Dual(self.value + other.value, self.tangent + other.tangent)
        return NotImplemented if isinstance(other, np.ndarray) else Dual(self.value + other, self.tangent)

    def __mul__(self, other):
        if isinstance(other, Dual):
            return Dual(self.value * other.value, self.tangent * other.value + other.tangent * self.value)
        return NotImplemented if isinstance(other, np.ndarray) else Dual(self.value * other, self.tangent * other)

    def __sub__(self, other):
        if isinstance(other, Dual):
            return Dual(self.value - other.value, self.tangent - other.tangent)
        return NotImplemented if isinstance(other, np.ndarray) else Dual(self.value - other, self.tangent)

    def __truediv__(self, other):
        if isinstance(other, Dual):
            ratio = self.value / other.value
            return Dual(ratio, (self.tangent - other.tangent * ratio) / other.value)
        return NotImplemented if isinstance(other, np.ndarray) else Dual(self.value / other, self.tangent / other)

    def __rtruediv__(self, other):
        ratio = other / self.value
        return Dual(ratio, self.tangent * (-ratio / self.value))

    def __rsub__(self, other):
        return Dual(other - self.value, -self.tangent)

    def __neg__(self):
        return Dual(-self.value, -self.tangent)

    def __abs__(self):
        return -self if self.value < 0 else self

    __radd__ = __add__
    __rmul__ = __mul__

    def __gt__(self, other):
        return Condition(self.value > value_of(other))

    def __lt__(self, other):
        return Condition(self.value < value_of(other))

    def __ge__(self, other):
        return Condition(self.value >= value_of(other))

    def __le__(self, other):
        return Condition(self.value <= value_of(other))

    def __bool__(self):
        raise TypeError("a function asks for the truth of a scalar")

    def sin(self):
        """Return the sine."""
        of = functions(self.value)
        return Dual(of.sin(self.value), self.tangent * of.cos(self.value))

    def cos(self):
        """Return the cosine."""
        of = functions(self.value)
        return Dual(of.cos(self.value), self.tangent * -of.sin(self.value))

    def sqrt(self):
        """Return the square root, its slope at 0 taken as 0."""
        root = functions(self.value).sqrt(self.value)
        return Dual(root, self.tangent / (2 * root) if root != 0 else 0 * self.tangent)

    def where(self, a, b):
        """Mark it as a scalar of its own kind; a number is no condition."""
        raise TypeError("a number is no condition")


def functions(number) -> ModuleType:
    """Return the module whose sine, cosine and root a number takes."""
    if isinstance(number, float | int):
        return math
    import gmpy2

    return gmpy2


def value_of(x):
    """Return the value of a scalar, a plain number's too."""
    return x.value if isinstance(x, Dual) else x


class Condition:
    """The outcome of a comparison: it selects, and has no truth value."""

    def __init__(self, holds: bool) -> None:
        self.holds = holds

    def where(self, a, b):
        """Return a or b."""
        return a if self.holds else b

    def __bool__(self):
        raise TypeError("an algorithm branches on a value")


def duals(values, tangents) -> np.ndarray:
    """Return an array of scalars with a tangent along one direction each."""
    values, tangents = np.broadcast_arrays(np.asarray(values, dtype=float), np.asarray(tangents, dtype=float))
    return with_tangents(values, tangents)


def with_tangents(values: np.ndarray, tangents: np.ndarray) -> np.ndarray:
    """Return an array of scalars with tangents.

    Args:
        values: (...) numbers.
        tangents: (..., directions) numbers, or (...) for one direction.
    """
    found = np.empty(np.shape(values), dtype=object)
    for index in np.ndindex(found.shape):
        x = values[index]
        found[index] = Dual(float(x) if isinstance(x, np.floating) else x, tangents[index])
    return found


def values_of(entries: np.ndarray) -> np.ndarray:
    """Return the values of an array of scalars, some of which may be plain numbers."""
    entries = np.asarray(entries)
    found = np.array([value_of(x) for x in entries.flat])
    return found.reshape(entries.shape)


def slopes_of(entries) -> np.ndarray:
    """Return the tangents along one direction, 0 for plain numbers."""
    return np.vectorize(lambda x: getattr(x, "tangent", 0.0), otypes=[float])(entries)


def tangents_of(entries: np.ndarray, directions: int) -> np.ndarray:
    """Return the tangents (..., directions) of an array of scalars, those of plain numbers 0."""
    entries, none = np.asarray(entries), np.zeros(directions)
    found = np.array([x.tangent if isinstance(x, Dual) else none for x in entries.flat])
    return found.reshape(*entries.shape, directions)
