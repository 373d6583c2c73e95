"""Two number systems for one oracle, float64 and many decimal digits, and linear systems in them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import SuperLU, splu


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


LEFT = 1e-44  # residual that counts as solved, of the right-hand side or 1; 50 digits hold 1e-50
REFINEMENTS = 40


class SparseSystem:
    """A square system that is written down block by block; each unknown has an equation of the same number.

    Attributes:
        numbers: its arithmetic.
        rows: by equation, coefficient by unknown.
        rhs: by equation.
    """

    def __init__(self, numbers: Arithmetic) -> None:
        self.numbers = numbers
        self.rows: list[dict[int, object]] = []
        self.rhs: list[object] = []

    def unknowns(self, rhs: np.ndarray) -> slice:
        """Return new unknowns, whose equations have a right-hand side and no coefficients yet."""
        start = len(self.rows)
        self.rows += [{} for _ in rhs]
        self.rhs += list(rhs)
        return slice(start, len(self.rows))

    def add(self, equations: slice, unknowns: slice, block: np.ndarray) -> None:
        """Add a block to the coefficients."""
        for row, values in zip(self.rows[equations], block, strict=True):
            for j, value in enumerate(values, start=unknowns.start):
                if value != 0:
                    row[j] = row[j] + value if j in row else value

    def add_both(self, equations: slice, unknowns: slice, block: np.ndarray) -> None:
        """Add a block, and its transpose where a symmetric system has it."""
        self.add(equations, unknowns, block)
        self.add(unknowns, equations, block.T)

    def floats(self, equations: Sequence[int], unknowns: Sequence[int]) -> csc_matrix:
        """Return some equations' coefficients of some unknowns in float64."""
        place = {j: k for k, j in enumerate(unknowns)}
        found = [
            (float(value), i, place[j])
            for i, row in enumerate(equations)
            for j, value in self.rows[row].items()
            if j in place
        ]
        values, i, j = zip(*found, strict=True) if found else ((), (), ())
        return csc_matrix((values, (i, j)), shape=(len(equations), len(unknowns)))

    def factors(self, kept: Sequence[int]) -> SuperLU:
        """Return float64 factors of the system that some equations and their unknowns are."""
        return splu(self.floats(kept, kept))

    def solved(self, kept: Sequence[int]) -> np.ndarray:
        """Return the unknowns when some equations are kept, the other unknowns 0.

        Raises:
            ArithmeticError: the residual, in the system's arithmetic, does not get small.
        """
        lu, zero = self.factors(kept), self.numbers.array(0.0)[()]
        x = np.full(len(self.rows), zero, dtype=object)
        size = max(1.0, *(abs(float(self.rhs[i])) for i in kept))
        for _ in range(REFINEMENTS):
            left = self.residual(x, kept)
            if max(map(abs, left)) <= LEFT * size:
                return x
            scale = max(map(abs, left))
            step = lu.solve(np.array([float(one / scale) for one in left]))
            x[kept] = x[kept] + self.numbers.array(step) * scale
        raise ArithmeticError(f"a residual of {float(max(map(abs, left))):.1e} is left: the system is nearly singular")

    def residual(self, x: np.ndarray, equations: Sequence[int]) -> list:
        """Return right-hand sides less coefficients times x."""
        return [self.rhs[i] - sum(value * x[j] for j, value in self.rows[i].items()) for i in equations]
