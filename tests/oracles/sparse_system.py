"""A sparse linear system of any arithmetic, solved by float64 factors and refined until its residual says so."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import SuperLU, splu

from tests.oracles.arithmetic import Arithmetic

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
