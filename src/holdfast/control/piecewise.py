"""Piecewise quintic polynomials of one variable, on floats and in machine code."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from holdfast.spatial.scalar import Array, Scalar, scan, select


def row_at(x: Scalar, begins: Array, rows: Array) -> Array:
    """Return the row of a table whose interval contains x; the first and the last one have no outer end.

    Args:
        x: the variable.
        begins: (k,) where the intervals begin, increasing.
        rows: (k, ...) the table.
    """
    if isinstance(x, float):
        return rows[max(int(np.searchsorted(begins, x, side="right")) - 1, 0)]

    def later(found: Array, begin: Scalar, row: Array) -> tuple[Array, None]:
        return select(x >= begin, row, found), None

    return scan(later, rows[0], begins[1:], rows[1:])[0]


def quintics_between(first: Sequence[Array], last: Sequence[Array]) -> Array:
    """Return the coefficients of quintics with given values and two derivatives at x = 0 and 1, (..., 6).

    Args:
        first: values and derivatives at 0, (...) each.
        last: those at 1.
    """
    (y0, v0, a0), (y1, v1, a1) = first, last
    d = y1 - y0
    return np.stack(
        [
            y0,
            v0,
            0.5 * a0,
            10 * d - 6 * v0 - 4 * v1 - 1.5 * a0 + 0.5 * a1,
            -15 * d + 8 * v0 + 7 * v1 + 1.5 * a0 - a1,
            6 * d - 3 * v0 - 3 * v1 - 0.5 * a0 + 0.5 * a1,
        ],
        axis=-1,
    )


def polynomial(c: Array, x: Scalar) -> tuple[Array, Array, Array]:
    """Return sum_j c_j x^j and its first two derivatives for coefficients c, (coordinates, 6)."""
    value, rate, half = c[:, 5], 0.0 * c[:, 5], 0.0 * c[:, 5]
    for j in range(4, -1, -1):
        half = half * x + rate
        rate = rate * x + value
        value = value * x + c[:, j]
    return value, rate, 2.0 * half
