"""Gauss elimination for general square systems: pivots are chosen by value, so never traced."""

from __future__ import annotations

import numpy as np

from holdfast.spatial.scalar import Array
from holdfast.spatial.vector import outer

NULL_PIVOT = 1e-13


def gauss_solve(matrix: Array, rhs: Array) -> tuple[Array, int]:
    """Return x with matrix x = rhs, and the nullity, by elimination with complete pivoting.

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
    A = np.array((matrix.T * rows).T * columns)
    b = np.array(rhs * rows)
    place = np.arange(n)  # of the unknowns, as columns are exchanged
    for j in range(n):
        sizes = np.abs(_values(A[j:, j:]))
        row, column = (j + int(k) for k in np.unravel_index(np.argmax(sizes), sizes.shape))
        if sizes.max() <= NULL_PIVOT:
            return 0.0 * rhs, n - j
        A[[j, row]], b[[j, row]] = A[[row, j]], b[[row, j]]
        A[:, [j, column]], place[[j, column]] = A[:, [column, j]], place[[column, j]]
        factors = A[j + 1 :, j] / A[j, j]
        A[j + 1 :, j + 1 :] = A[j + 1 :, j + 1 :] - outer(factors, A[j, j + 1 :])
        b[j + 1 :] = b[j + 1 :] - factors * b[j]
    x = b
    for j in reversed(range(n)):
        x[j] = (b[j] - A[j, j + 1 :] @ x[j + 1 :]) / A[j, j]
    found = np.array(x)
    found[place] = x
    return found * columns, 0


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
