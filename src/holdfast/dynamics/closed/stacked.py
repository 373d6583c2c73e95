"""The aggregate matrices of (2.2), for the dense algorithms.

They are stacked over the arms with a grasp, in order; world axes, about contact points or C.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from holdfast.dynamics.arm.bias import bias_torque
from holdfast.dynamics.arm.forward_kinematics import jacobian
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution
from holdfast.spatial.linalg import back_substitution, cholesky, forward_substitution
from holdfast.spatial.scalar import Array, concatenate
from holdfast.spatial.spatial_vector import twist_shift


class Stacked:
    """The stacked quantities of a chain, each computed when it is first used.

    The names follow the paper: M (script), J, C, T and the object's M(C), b(C), A, a(C).
    """

    def __init__(self, motion: ChainMotion) -> None:
        self.motion = motion

    @cached_property
    def J_blocks(self) -> list[Array]:
        """Tip Jacobians, (6, N) each."""
        return [jacobian(arm.arm, arm.at) for arm in self.motion.holding]

    @cached_property
    def M_blocks(self) -> list[Array]:
        """Joint mass matrices, (N, N) each."""
        return [mass_matrix(arm.arm, arm.at)[0] for arm in self.motion.holding]

    @cached_property
    def J(self) -> Array:
        """diag(J_i), (6l, n)."""
        return block_diagonal(self.J_blocks)

    @cached_property
    def M(self) -> Array:
        """diag(M_i), (n, n)."""
        return block_diagonal(self.M_blocks)

    @cached_property
    def T_free(self) -> Array:
        """T' = T - C (2.15a), (n,)."""
        return concatenate(
            arm.torque - bias_torque(arm.arm, arm.at, arm.bias.wrenches)[0] for arm in self.motion.holding
        )

    @cached_property
    def Jdot_qd(self) -> Array:
        """Jdot thetadot minus [0; g], (6l,)."""
        return concatenate(arm.bias.tip_acceleration for arm in self.motion.holding)

    @cached_property
    def A(self) -> Array:
        """A = [phi^T(C, O_i)] (2.6), (6l, 6): V(0) = A V(C)."""
        blocks = [twist_shift(c.offset) for c in self.motion.contacts]
        return np.concatenate(blocks) if blocks else np.zeros((0, 6))

    @cached_property
    def a(self) -> Array:
        """a(C), (6l,)."""
        return concatenate(c.a for c in self.motion.contacts)

    @cached_property
    def g(self) -> Array:
        """Hdot^T W, (6l,)."""
        return concatenate(c.g for c in self.motion.contacts)

    @cached_property
    def HT(self) -> Array:
        """H^T(0) = diag([h_i; 0]) (a.6), (6l, sum n_g)."""
        return block_diagonal([c.HT for c in self.motion.contacts])

    @cached_property
    def K(self) -> Array:
        """diag(K_i), with orthonormal rows and K H^T = 0, (6l - sum n_g, 6l)."""
        return block_diagonal([c.K for c in self.motion.contacts])

    @cached_property
    def M_C(self) -> Array:
        """M(C), (6, 6)."""
        return self.motion.body.inertia.dense()

    @cached_property
    def M_C_inverse(self) -> Array:
        """M(C)^-1, (6, 6)."""
        return self.motion.body.mobility.dense()

    @property
    def b(self) -> Array:
        """b(C) minus the external wrench, (6,)."""
        return self.motion.body.bias - self.motion.body.wrench

    @property
    def object_free(self) -> Array:
        """-M(C)^-1 b(C), including the external wrench, minus [0; g], (6,)."""
        return self.motion.body.free_acceleration + self.M_C_inverse @ self.motion.body.wrench

    @cached_property
    def a_prime(self) -> Array:
        """a'(C) = a(C) - A M(C)^-1 b(C) - Jdot thetadot (2.15b), (6l,)."""
        return self.a + self.A @ self.object_free - self.Jdot_qd

    def mass_solve(self, b: Array) -> Array:
        """Return M^-1 b for b (n,) or (n, m), arm by arm."""
        parts, start = [], 0
        for M in self.M_blocks:
            L = cholesky(M)
            parts.append(back_substitution(L, forward_substitution(L, b[start : start + len(M)])))
            start += len(M)
        return np.concatenate(parts) if parts else b

    def solution(self, qdd: Array, f: Array, W_dot: Array | None = None, alpha_C: Array | None = None) -> Solution:
        """Return the solution from stacked results; alpha(C) = M(C)^-1 (A^T f - b(C)) unless it is given."""
        if alpha_C is None:
            alpha_C = self.M_C_inverse @ (self.A.T @ f) + self.object_free
        ends = np.cumsum([arm.arm.joint_count for arm in self.motion.holding])
        return Solution(
            list(np.split(qdd, ends[:-1])) if len(ends) else [],
            [f[6 * i : 6 * i + 6] for i in range(len(ends))],
            alpha_C,
            W_dot,
        )


def block_diagonal(blocks: list[Array]) -> Array:
    """Return the matrix with the given blocks on its diagonal and zeros elsewhere."""
    height, width = (sum(b.shape[axis] for b in blocks) for axis in (0, 1))
    rows, before = [], 0
    for b in blocks:
        after = width - before - b.shape[1]
        rows.append(np.hstack([np.zeros((len(b), before)), b, np.zeros((len(b), after))]))
        before += b.shape[1]
    return np.concatenate(rows) if rows else np.zeros((height, width))
