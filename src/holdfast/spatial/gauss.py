"""Gauss elimination for general square systems: pivots are chosen by value, so never traced."""

from __future__ import annotations

import numpy as np

from holdfast.spatial.scalar import Array
from holdfast.spatial.vector import outer

NULL_PIVOT = 1e-13


def gauss_solve(matrix: Array, rhs: Array) -> tuple[Array, int]:
    """Return x with matrix x = rhs, and the nullity, by elimination with row pivoting.

    Rows and columns are first scaled by powers of two to entries of about 1 (exact), so
    that neither units nor a light object decide what counts as null.

    Args:
        matrix: (n, n).
        rhs: (n,).

    Returns:
        (n,) solution, meaningless if the nullity is not 0; the number of null pivots.
    """
    n = len(matrix)
    rows, columns = _power_of_two_scales(_values(matrix))
    A = (matrix.T * rows).T * columns
    b = rhs * rows
    A, b = np.array(A), np.array(b)
    row = 0  # stays behind the column once a column has no pivot
    for j in range(n):
        pivot = row + int(np.argmax(np.abs(_values(A[row:, j]))))
        if abs(_values(A[pivot, j])) <= NULL_PIVOT:
            continue
        if pivot != row:
            A[[row, pivot]] = A[[pivot, row]]
            b[[row, pivot]] = b[[pivot, row]]
        factors = A[row + 1 :, j] / A[row, j]
        A[row + 1 :, j + 1 :] = A[row + 1 :, j + 1 :] - outer(factors, A[row, j + 1 :])
        b[row + 1 :] = b[row + 1 :] - factors * b[row]
        row += 1
        if row == n:
            break
    if row < n:
        return 0.0 * rhs, n - row
    x = b
    for j in reversed(range(n)):
        x[j] = (b[j] - A[j, j + 1 :] @ x[j + 1 :]) / A[j, j]
    return x * columns, 0


def _values(entries: Array) -> Array:
    """Return the entries as floats; a counting scalar carries its value."""
    return np.vectorize(lambda x: float(getattr(x, "value", x)), otypes=[float])(entries)


def _power_of_two_scales(A: Array) -> tuple[Array, Array]:
    """Return row and column factors, powers of two, that bring the entries near 1 (Ruiz)."""
    rows, columns = np.ones(len(A)), np.ones(len(A))
    for _ in range(8):
        scaled = np.abs((A.T * rows).T * columns)
        for factors, axis in ((rows, 1), (columns, 0)):
            size = scaled.max(axis=axis, initial=0.0)
            factors *= np.exp2(-np.round(0.5 * np.log2(np.where(size > 0, size, 1.0))))
    return rows, columns
