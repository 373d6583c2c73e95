"""Two number systems for one oracle: float64 and many decimal digits.

The oracle is written on small NumPy arrays.  With many digits the arrays hold
``gmpy2.mpfr`` objects, so the same lines of text run in either arithmetic.
"""

import math
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Arithmetic:
    """Hold what differs between float64 and many-digit scalars.

    Attributes:
        array: turns nested numbers into an array of this arithmetic's scalars.
        sin: sine of one scalar [rad].
        cos: cosine of one scalar [rad].
        solve: solves a square dense system ``A x = b``.
        precision: returns the context in which all of it is computed.
    """

    array: Callable
    sin: Callable
    cos: Callable
    solve: Callable
    precision: Callable[[], AbstractContextManager]


def arithmetic(digits: int | None) -> Arithmetic:
    """Return float64 arithmetic (``digits=None``) or one of that many digits."""
    if digits is None:
        return Arithmetic(
            lambda values: np.array(values, dtype=float), math.sin, math.cos, np.linalg.solve, nullcontext
        )
    import gmpy2

    bits = math.ceil(digits * math.log2(10)) + 4
    return Arithmetic(
        lambda values: _object_array(values, gmpy2.mpfr),
        gmpy2.sin,
        gmpy2.cos,
        solve_by_elimination,
        lambda: gmpy2.context(precision=bits),
    )


def _object_array(values, scalar: Callable) -> np.ndarray:
    """Return the values as an object array; float64 inputs are taken as exact."""
    floats = np.array(values, dtype=float)
    numbers = np.empty(floats.size, dtype=object)
    numbers[:] = [scalar(value) for value in floats.ravel().tolist()]
    return numbers.reshape(floats.shape)


def solve_by_elimination(matrix: np.ndarray, rhs: np.ndarray) -> np.ndarray:
    """Solve ``matrix x = rhs`` by Gaussian elimination with partial pivoting.

    Plain lists are several times faster than array indexing for big scalars, and
    skipping zero multipliers pays because a KKT matrix is mostly zero.

    Args:
        matrix: (n, n) scalars of any kind that has + - * / and abs.
        rhs: (n,) scalars, or (n, m) for several right-hand sides.

    Returns:
        (n,) or (n, m) object array.

    Raises:
        ZeroDivisionError: the matrix is exactly singular.
    """
    rows = [[*row, *values] for row, values in zip(matrix, np.reshape(rhs, (len(matrix), -1)), strict=True)]
    size, width = len(rows), len(rows[0])
    for column in range(size):
        best = max(range(column, size), key=lambda i, column=column: abs(rows[i][column]))
        if rows[best][column] == 0:
            raise ZeroDivisionError(f"column {column} of {size} has no pivot")
        rows[column], rows[best] = rows[best], rows[column]
        pivot = rows[column]
        active = [(j, pivot[j]) for j in range(column + 1, width) if pivot[j] != 0]
        for row in rows[column + 1 :]:
            if row[column] != 0:
                factor = row[column] / pivot[column]
                for j, value in active:
                    row[j] = row[j] - factor * value
    solution = np.empty((size, width - size), dtype=object)
    for i in reversed(range(size)):
        known = [(j, rows[i][j]) for j in range(i + 1, size) if rows[i][j] != 0]
        for k in range(width - size):
            solution[i, k] = (rows[i][size + k] - sum(x * solution[j, k] for j, x in known)) / rows[i][i]
    return solution.reshape(np.shape(rhs))
