"""The matrix Omega = J M^-1 J^T + A M(C)^-1 A^T (3.1), its factorisation, and the arms' operators of Sec. 6."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.dynamics.arm.articulated import ArmFilter, articulated_filter, smooth, tip_mobility, whiten
from holdfast.dynamics.arm.bias import bias_torque
from holdfast.dynamics.arm.motion import ArmMotion
from holdfast.dynamics.closed.chain_motion import ChainMotion
from holdfast.dynamics.closed.stacked import Stacked, block_diagonal
from holdfast.errors import MethodNotApplicable
from holdfast.spatial.linalg import MaskedLDL, ldl, ldl_solve
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import rotate, unrotate

# Omega is the sum of the arms' and the object's mobility. If its scaled pivots are below this value, the smaller of the
# two has lost so many digits in the sum that an accuracy of 1e-9 is not guaranteed.
WEAKEST_PIVOT = 1e-5


@dataclass(frozen=True, eq=False)
class FilteredArm:
    """An arm prepared for filtering and smoothing; tip quantities are along world axes.

    Attributes:
        motion: the arm's motion.
        filter: D and G of its mass matrix.
        T_free: (N,) T' = T - C (6.1a).
    """

    motion: ArmMotion
    filter: ArmFilter
    T_free: Array

    def residual(self, T: Array | None, f: Array | None = None) -> Array:
        """Return eps = T - H psi (S L T + B f), (N,): the causal filter of (6.17)."""
        tip_wrench = None if f is None else unrotate(self.motion.at.end, f)
        return whiten(self.motion.arm, self.motion.at, self.filter, T, None, tip_wrench)[0]

    def smoothed(self, eps: Array) -> tuple[Array, Array]:
        """Return (I - H Psi L)^T D^-1 eps, (N,), and B^T psi^T H^T D^-1 eps, (6,)."""
        qdd, tip = smooth(self.motion.arm, self.motion.at, self.filter, eps / self.filter.D)
        return qdd, rotate(self.motion.at.end, tip)

    def free_tip(self) -> Array:
        """Return J M^-1 T', (6,), the tip acceleration due to the torques alone (6.13)."""
        return self.smoothed(self.residual(self.T_free))[1]

    def accelerations(self, f: Array) -> Array:
        """Return M^-1 (T' - J^T f), (N,), by filtering torques and grasp force together (6.17)."""
        return self.smoothed(self.residual(self.T_free, f))[0]


def filtered_arms(motion: ChainMotion) -> list[FilteredArm]:
    """Return the filtered arms, for all arms with a grasp. Two inward sweeps per arm, O(n)."""
    return [
        FilteredArm(
            arm, articulated_filter(arm.arm, arm.at), arm.torque - bias_torque(arm.arm, arm.at, arm.bias.wrenches)[0]
        )
        for arm in motion.holding
    ]


def per_arm(stacked: Array) -> list[Array]:
    """Return the 6-vectors of a stack as a list."""
    return list(np.reshape(stacked, (-1, 6)))


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
