"""What is known of a body once everything that hangs on it has settled: the response of its joint.

    D = H^T I H + armature,   G = I H D^-1,   eps = torque - H^T z,   nu = D^-1 eps
    I(p) += phi (I - G H^T I) phi^T,   z(p) += phi (z + G eps)
    beta(k) = psi^T beta(p) + H nu,    psi^T = (1 - H G^T) phi^T

For a free body, D is its articulated inertia and nu = -D^-1 z its acceleration without an external wrench, which is
treated apart: M^-1 w of a light body would be huge, and would cancel later.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.dynamics.tree.forest_motion import BodyMotion
from holdfast.spatial.linalg import MaskedLDL, back_substitution, ldl, ldl_solve
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench
from holdfast.spatial.symmetric import Symmetric6, symmetric6

LEAST_PIVOT = 1e-15  # pivots of D that are smaller, relative to its diagonal, are zero


class SettledBody(NamedTuple):
    """A body and the response of its joint.

    Attributes:
        motion: its motion.
        factors: D = L diag(d) L^T, (m, m); of a free body, of its articulated inertia.
        columns: (6, m) H L^-T, the columns of H D^-1 H^T = sum 1/d h h^T.
        G: (6, m).
        eps: (m,); 0 for a free body.
        nu: (m,).
        inertia: I(k), of everything that hangs on it.
        load: (6,) z(k).
    """

    motion: BodyMotion
    factors: MaskedLDL
    columns: Array
    G: Array
    eps: Array
    nu: Array
    inertia: Symmetric6
    load: Array

    @property
    def mobility(self) -> Array:
        """(6, 6) H D^-1 H^T, what the joint adds to the mobility of its body."""
        return (self.columns * self.factors.inverse_pivots) @ self.columns.T

    def carried(self, x: Array) -> Array:
        """Return psi^T x, what remains on the body of accelerations (6, columns) of its parent."""
        moved = self.moved(x)
        return moved - self.motion.H @ (self.G.T @ moved)

    def moved(self, x: Array) -> Array:
        """Return phi^T x, accelerations (6, columns) of the parent at the body's point while the joint is locked."""
        return np.reshape([shift_twist(self.motion.reach, column) for column in x.T], x.T.shape).T

    def per_innovation(self) -> Array:
        """Return L^-T, (m, m), the accelerations of the joint per independent innovation."""
        return back_substitution(self.factors.L, np.eye(len(self.nu)))

    def through(self, t: Array, more: Array | float = 0.0) -> tuple[Array, Array]:
        """Return D^-1 (H^T t + more), and the wrench that reaches the parent's point.

        Args:
            t: (6,) wrench on the body.
            more: (m,) further torque on its joint.
        """
        on_joint = self.motion.H.T @ t + more
        return ldl_solve(self.factors, on_joint), shift_wrench(self.motion.reach, t - self.G @ on_joint)

    def onto_parent(self) -> tuple[Symmetric6, Array]:
        """Return the inertia and the load (6,) at the parent's point."""
        I = self.inertia.dense()
        IH = I @ self.motion.H
        inertia = symmetric6(I - self.G @ IH.T).inertia_shifted(self.motion.reach)
        return inertia, shift_wrench(self.motion.reach, self.load + self.G @ self.eps)


def settled_body(motion: BodyMotion, inertia: Symmetric6, load: Array) -> SettledBody:
    """Return the response of a body's joint.

    Args:
        motion: the body.
        inertia: I(k), with everything that hangs on it.
        load: (6,) z(k).
    """
    H, I = motion.H, inertia.dense()
    IH = I @ H
    D = I if motion.floats else H.T @ IH + np.diag(motion.armature)
    factors = ldl(D, np.diag(D), LEAST_PIVOT)
    columns = H @ back_substitution(factors.L, np.eye(len(D)))
    if motion.floats:
        none = np.zeros(6)
        return SettledBody(motion, factors, columns, np.eye(6), none, -ldl_solve(factors, load), inertia, load)
    eps = motion.torque - H.T @ load
    return SettledBody(
        motion, factors, columns, ldl_solve(factors, IH.T).T, eps, ldl_solve(factors, eps), inertia, load
    )
