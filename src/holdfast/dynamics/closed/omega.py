"""The matrix Omega = J M^-1 J^T + A M(C)^-1 A^T (3.1) and its factorisation."""

from __future__ import annotations

import numpy as np

from holdfast.dynamics.arm.tip_mobility import tip_mobility
from holdfast.dynamics.closed.filtered_arm import FilteredArm
from holdfast.dynamics.closed.stacked import Stacked, block_diagonal
from holdfast.errors import MethodNotApplicable
from holdfast.spatial.linalg import MaskedLDL, ldl, ldl_solve
from holdfast.spatial.scalar import Array

# Omega is the sum of the arms' and the object's mobility. If its scaled pivots are below this value, the smaller of the
# two has lost so many digits in the sum that an accuracy of 1e-9 is not guaranteed.
WEAKEST_PIVOT = 1e-5


class Omega:
    """The factorised Omega; `solve(b)` returns Omega^-1 b.

    Raises:
        MethodNotApplicable: Omega is singular or too ill-conditioned.
    """

    def __init__(self, matrix: Array) -> None:
        self.matrix = matrix
        self._factors: MaskedLDL = ldl(matrix, np.diag(matrix))
        size, kept = len(matrix), self._factors.kept
        if kept < size:
            raise MethodNotApplicable(
                f"needs Omega regular, but its nullity is {size - kept} of {size}; try method='sequential'"
            )
        if self._factors.weakest < WEAKEST_PIVOT:
            raise MethodNotApplicable(
                f"Omega's smallest scaled pivot is {float(self._factors.weakest):.1e}: object and arms differ so"
                " much in mobility that their sum loses the digits; try method='sequential'"
            )

    def solve(self, b: Array) -> Array:
        """Return Omega^-1 b, b (6l,) or (6l, m)."""
        return ldl_solve(self._factors, b)


def omega_from_matrices(s: Stacked) -> Omega:
    """Return Omega from mass matrices and Jacobians (4.9c)."""
    return Omega(s.J @ s.mass_solve(s.J.T) + s.A @ s.M_C_inverse @ s.A.T)


def omega_recursive(s: Stacked, arms: list[FilteredArm]) -> Omega:
    """Return Omega from the recursion (6.10) for each arm (6.11d, e)."""
    mobilities = [
        tip_mobility(arm.motion.arm, arm.motion.at, arm.filter).rotated(arm.motion.at.end).dense() for arm in arms
    ]
    return Omega(block_diagonal(mobilities) + s.A @ s.M_C_inverse @ s.A.T)
