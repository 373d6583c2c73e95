"""The vocabulary of algorithms: functions that work on every kind of scalar, and on arrays entry by entry.

A scalar is a `float`, or an object that brings its own `sin`, `cos`, `sqrt` and `where`, such as a node of a traced
graph. An algorithm written with these functions, `+ - * /` and NumPy arrays runs on all of them; it must not branch on
a value with Python's `if`. Arrays and lists broadcast as NumPy's do.

Loops over arms, links or grasps are written with `each` and `scan`, so that a trace sees a loop where there is one.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from contextvars import ContextVar
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Scalar = Any
Array = NDArray[Any]
_ARRAYS = (np.ndarray, list, tuple)
_LARGEST_EXPONENT = 709.782712893384  # log of the largest float
_ROUNDER = 1.5 * 2.0**52  # floats of this size are integers


class Loops(Protocol):
    """What runs the loops of an algorithm instead of Python: the compiler while it traces it."""

    @property
    def inside(self) -> bool:
        """Whether a loop is being traced; loops inside it run in Python."""
        ...

    def each(self, f: Callable[..., Any], items: list[tuple[Any, ...]]) -> list[Any]:
        """Run the loop of `each`."""
        ...

    def scan(self, f: Callable[..., Any], carry: Any, items: list[tuple[Any, ...]]) -> tuple[Any, list[Any]]:
        """Run the loop of `scan`."""
        ...


loops: ContextVar[Loops | None] = ContextVar("loops", default=None)  # None: Python's own


def each(f: Callable[..., Any], *items: Iterable[Any]) -> list[Any]:
    """Return f of every item, items that do not depend on each other; several lists go side by side, as in `zip`."""
    rows, taker = list(zip(*items, strict=True)), loops.get()
    return taker.each(f, rows) if taker is not None and rows and not taker.inside else [f(*row) for row in rows]


def each_of(names: Iterable[str], f: Callable[..., Any], *tables: Mapping[str, Any]) -> dict[str, Any]:
    """Return by name f of the rows of several tables, rows that do not depend on each other; see `each`."""
    names = list(names)
    found = each(f, *([table[name] for name in names] for table in tables))
    return dict(zip(names, found, strict=True))


def scan(f: Callable[..., Any], carry: Any, *items: Iterable[Any]) -> tuple[Any, list[Any]]:
    """Return the last carry and all results: carry, result = f(carry, item), one item after the other."""
    rows, taker, found = list(zip(*items, strict=True)), loops.get(), []
    if taker is not None and rows and not taker.inside:
        return taker.scan(f, carry, rows)
    for row in rows:
        carry, one = f(carry, *row)
        found.append(one)
    return carry, found


def sin(x: Scalar) -> Scalar:
    """Return the sine of an angle in radians."""
    if isinstance(x, _ARRAYS):
        return _entrywise(sin, x)
    return x.sin() if hasattr(x, "sin") else math.sin(x)


def cos(x: Scalar) -> Scalar:
    """Return the cosine of an angle in radians."""
    if isinstance(x, _ARRAYS):
        return _entrywise(cos, x)
    return x.cos() if hasattr(x, "cos") else math.cos(x)


def sqrt(x: Scalar) -> Scalar:
    """Return the square root; not a number if x is negative."""
    if isinstance(x, _ARRAYS):
        return _entrywise(sqrt, x)
    return x.sqrt() if hasattr(x, "sqrt") else math.sqrt(x) if x >= 0 else math.nan


def exp(x: Scalar) -> Scalar:
    """Return the exponential; infinite where it overflows."""
    if isinstance(x, _ARRAYS):
        return _entrywise(exp, x)
    if hasattr(x, "exp"):
        return x.exp()
    return math.inf if x > _LARGEST_EXPONENT else math.exp(x)


def tanh(x: Scalar) -> Scalar:
    """Return the hyperbolic tangent, which goes smoothly from -1 to 1: a soft limit."""
    if isinstance(x, _ARRAYS):
        return _entrywise(tanh, x)
    return x.tanh() if hasattr(x, "tanh") else math.tanh(x)


def arctan2(y: Scalar, x: Scalar) -> Scalar:
    """Return the angle of the point (x, y), in (-pi, pi] [rad]; 0 for the origin, and zeros have no sign."""
    if isinstance(y, _ARRAYS) or isinstance(x, _ARRAYS):
        return _entrywise(arctan2, y, x)
    if hasattr(y, "arctan2") and not hasattr(x, "chosen"):
        return y.arctan2(x)
    return x.arctan2_of(y) if hasattr(x, "arctan2_of") else math.atan2(y + 0.0, x + 0.0)


def reciprocal(x: Scalar) -> Scalar:
    """Return 1 / x; infinite at zero."""
    if isinstance(x, _ARRAYS):
        return _entrywise(reciprocal, x)
    return 1.0 / x if hasattr(x, "where") or x != 0 else math.inf


def rint(x: Scalar) -> Scalar:
    """Return the nearest integer, the even one of two; |x| must be below 2^51. A derivative refuses it."""
    if isinstance(x, _ARRAYS):
        return _entrywise(rint, x)
    return x.rint() if hasattr(x, "rint") else (x + _ROUNDER) - _ROUNDER


def less(a: Scalar, b: Scalar) -> Scalar:
    """Return whether a < b, also of arrays of traced scalars, which Python's `<` cannot compare."""
    if isinstance(a, _ARRAYS) or isinstance(b, _ARRAYS):
        return _entrywise(less, a, b)
    return a < b


def less_equal(a: Scalar, b: Scalar) -> Scalar:
    """Return whether a <= b, as `less` does."""
    if isinstance(a, _ARRAYS) or isinstance(b, _ARRAYS):
        return _entrywise(less_equal, a, b)
    return a <= b


def where(condition: Scalar, a: Scalar, b: Scalar) -> Scalar:
    """Return `a` if the condition holds, else `b`; both are evaluated beforehand."""
    if isinstance(a, _ARRAYS) or isinstance(b, _ARRAYS) or isinstance(condition, _ARRAYS):
        return _entrywise(where, condition, a, b)
    for x in (a, b):
        if hasattr(x, "chosen"):  # within a derivative
            return x.chosen(condition, a, b)
    return condition.where(a, b) if hasattr(condition, "where") else (a if condition else b)


def select(condition: Scalar, a: Array, b: Array) -> Array:
    """Return the array `a` if one condition holds, else `b`."""
    if not hasattr(condition, "where"):
        return a if condition else b
    return np.reshape([where(condition, x, y) for x, y in zip(a.flat, b.flat, strict=True)], a.shape)


def maximum(a: Scalar, b: Scalar) -> Scalar:
    """Return the larger of two."""
    if isinstance(a, _ARRAYS) or isinstance(b, _ARRAYS):
        return _entrywise(maximum, a, b, on_floats=lambda a, b: np.where(a > b, a, b))
    return where(a > b, a, b)


def minimum(a: Scalar, b: Scalar) -> Scalar:
    """Return the smaller of two."""
    if isinstance(a, _ARRAYS) or isinstance(b, _ARRAYS):
        return _entrywise(minimum, a, b, on_floats=lambda a, b: np.where(a < b, a, b))
    return where(a < b, a, b)


def clip(x: Scalar, low: Scalar, high: Scalar) -> Scalar:
    """Return x, or the limit that it is beyond."""
    return minimum(maximum(x, low), high)


def array(entries: Any) -> Array:
    """Return an array of the entries: float64 if all are numbers, else of objects."""
    return np.array(entries)


def concatenate(parts: Any) -> Array:
    """Return the 1-d arrays joined end to end; an empty list gives an empty array."""
    parts = list(parts)
    return np.concatenate(parts) if parts else np.zeros(0)


def _entrywise(of_scalars: Callable[..., Scalar], *arguments: Any, on_floats: Callable[..., Any] | None = None) -> Any:
    """Return a function of every entry of its arguments, which are broadcast; of arrays without axes a scalar.

    Args:
        of_scalars: the function of scalars.
        *arguments: arrays, lists or scalars.
        on_floats: the same function of arrays of floats, entry by entry.
    """
    arrays = np.broadcast_arrays(*arguments)
    if on_floats is not None and arrays[0].ndim and all(x.dtype == float for x in arrays):
        return on_floats(*arrays)
    found = [of_scalars(*entries) for entries in zip(*(a.flat for a in arrays), strict=True)]
    return np.reshape(found, arrays[0].shape) if arrays[0].ndim else found[0]
