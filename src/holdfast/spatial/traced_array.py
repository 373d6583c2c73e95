"""Arrays of traced scalars on which NumPy's functions that compare entries work, too.

On arrays of objects NumPy asks Python whether one entry is less than another, which no traced scalar can tell. So
`np.clip` and others are replaced here by the functions of `spatial.scalar` with the same meaning.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import numpy as np

from holdfast.spatial.scalar import Array, clip, cos, less, less_equal, maximum, minimum, rint, sin, sqrt, where


def _sign(x: Array) -> Array:
    return where(less(0.0, x), 1.0, where(less(x, 0.0), -1.0, 0.0))


REPLACEMENTS: dict[str, Callable[..., Any]] = {  # by the names of NumPy's functions
    "minimum": minimum,
    "maximum": maximum,
    "fmin": minimum,
    "fmax": maximum,
    "clip": clip,
    "less": less,
    "less_equal": less_equal,
    "greater": lambda a, b: less(b, a),
    "greater_equal": lambda a, b: less_equal(b, a),
    "sign": _sign,
    "rint": rint,
    "fabs": np.abs,
    "hypot": lambda a, b: sqrt(a * a + b * b),
    "tan": lambda x: sin(x) / cos(x),
    "deg2rad": lambda x: x * (math.pi / 180.0),
    "radians": lambda x: x * (math.pi / 180.0),
}
_DEFAULTS = {
    "dtype": None,
    "keepdims": False,
    "initial": getattr(np, "_NoValue", None),
    "where": True,
}  # of a reduction


class TracedArray(np.ndarray):
    """An array of traced scalars; NumPy functions of it return traced arrays."""

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, out: Any = None, **options: Any) -> Any:
        """Return the result of a function of NumPy, by its replacement if there is one."""
        given, own = [_plain(x) for x in inputs], REPLACEMENTS.get(ufunc.__name__)
        if own is not None and method == "__call__" and out is None:
            return as_traced(own(*given))
        usual = all(x is _DEFAULTS.get(name, x if name == "axis" else _DEFAULTS) for name, x in options.items())
        if own is not None and method == "reduce" and usual and out in (None, (None,)):  # as in `np.max`
            axis = options.get("axis", 0)
            rows = given[0].reshape(-1) if axis is None else np.moveaxis(given[0], axis, 0)
            return as_traced(functools.reduce(own, list(rows)))
        if out is not None:
            options["out"] = tuple(_plain(x) for x in out)
        return as_traced(getattr(ufunc, method)(*given, **options))

    def __array_function__(self, func: Any, types: Any, args: Any, kwargs: Any) -> Any:
        """Return the result of other functions of NumPy; `where` chooses entry by entry."""
        if func is np.where and len(args) == 3 and not kwargs:
            return as_traced(where(*map(_plain, args)))
        return super().__array_function__(func, types, args, kwargs)


def as_traced(x: Any) -> Any:
    """Return an array of traced scalars as a `TracedArray`, without a copy; anything else unchanged."""
    return x.view(TracedArray) if isinstance(x, np.ndarray) and x.dtype == object else x


def _plain(x: Any) -> Any:
    return x.view(np.ndarray) if isinstance(x, TracedArray) else x
