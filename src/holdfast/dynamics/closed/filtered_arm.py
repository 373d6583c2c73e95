"""One arm with its bias torque removed and its mass matrix factorised, for the operators of Sec. 6."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.dynamics.arm.articulated import Filter, articulated_filter, smooth, whiten
from holdfast.dynamics.arm.bias import bias_torque
from holdfast.dynamics.arm.motion import ArmMotion
from holdfast.dynamics.closed.chain_motion import ChainMotion
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import rotate, unrotate


@dataclass(frozen=True, eq=False)
class FilteredArm:
    """An arm prepared for filtering and smoothing; tip quantities are along world axes.

    Attributes:
        motion: the arm's motion.
        filter: D and G of its mass matrix.
        T_free: (N,) T' = T - C (6.1a).
    """

    motion: ArmMotion
    filter: Filter
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
