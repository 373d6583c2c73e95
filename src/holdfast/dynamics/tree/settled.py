"""What is known of a body once everything that hangs on it has settled: the response of its joint.

    D = H^T I H + armature,   G = I H D^-1,   eps = torque - H^T z,   nu = D^-1 eps
    I(p) += phi (I - G H^T I) phi^T,   z(p) += phi (z + G eps)
    beta(k) = psi^T beta(p) + H nu,    psi^T = (1 - H G^T) phi^T

For a free body, D is its articulated inertia and nu = -D^-1 z its acceleration without an external wrench, which is
treated apart: M^-1 w of a light body would be huge, and would cancel later.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.factored_mobility import FactoredMobility
from holdfast.dynamics.closed.object_motion import FreeBody
from holdfast.dynamics.tree.belief import Untouched
from holdfast.dynamics.tree.forest_motion import BodyMotion, ForestMotion
from holdfast.model.forest import GROUND
from holdfast.spatial.linalg import MaskedLDL, back_substitution, ldl, ldl_solve
from holdfast.spatial.scalar import Array, array
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench
from holdfast.spatial.symmetric import Symmetric6, symmetric6

LEAST_PIVOT = 1e-15  # pivots of D that are smaller, relative to its diagonal, are zero


class SettledBody(NamedTuple):
    """A body and the response of its joint.

    Attributes:
        motion: its motion.
        factors: D = L diag(d) L^T, (m, m); of a free body, of its articulated inertia. Of a free body by itself, only
            d is known.
        columns: (6, m) H L^-T, the columns of H D^-1 H^T = sum 1/d h h^T.
        G: (6, m).
        inertia: I(k), of everything that hangs on it.
        free: a free body on which nothing hangs.
    """

    motion: BodyMotion
    factors: MaskedLDL
    columns: Array
    G: Array
    inertia: Symmetric6
    free: FreeBody | None

    @property
    def mobility(self) -> Array:
        """(6, 6) H D^-1 H^T, what the joint adds to the mobility of its body."""
        return (self.columns * self.factors.inverse_pivots) @ self.columns.T

    @property
    def untouched(self) -> Untouched:
        """The mobility of a free body; that of a lone one in two blocks, each with its own digits."""
        if self.free is not None:
            return Untouched(self.free.mobility.dense(), FactoredMobility(self.free.D, self.free.w))
        D = self.factors.inverse_pivots.tolist()
        return Untouched(self.mobility, FactoredMobility(D, list(self.columns.T)))

    def nu(self, load: Array, torque: Array) -> Array:
        """Return D^-1 eps, (m,), for a load z (6,) and torques (m,); of a free body -D^-1 z."""
        return self.pushed(-load if self.motion.floats else torque - self.motion.H.T @ load)

    def pushed(self, eps: Array) -> Array:
        """Return D^-1 eps, (m,)."""
        return ldl_solve(self.factors, eps) if self.free is None else self.free.mobility.apply(eps)

    def carried(self, x: Array) -> Array:
        """Return psi^T x, what remains on the body of accelerations (6, columns) of its parent."""
        moved = self.moved(x)
        return moved - self.motion.H @ (self.G.T @ moved)

    def moved(self, x: Array) -> Array:
        """Return phi^T x, accelerations (6, columns) of the parent at the body's point while the joint is locked."""
        return np.reshape([shift_twist(self.motion.reach, column) for column in x.T], x.T.shape).T

    def per_innovation(self) -> Array:
        """Return L^-T, (m, m), the accelerations of the joint per independent innovation."""
        return back_substitution(self.factors.L, np.eye(len(self.factors.L)))

    def through(self, t: Array, more: Array | float = 0.0) -> tuple[Array, Array]:
        """Return D^-1 (H^T t + more), and the wrench that reaches the parent's point.

        Args:
            t: (6,) wrench on the body.
            more: (m,) further torque on its joint.
        """
        on_joint = self.motion.H.T @ t + more
        return ldl_solve(self.factors, on_joint), shift_wrench(self.motion.reach, t - self.G @ on_joint)

    def inertia_on_parent(self) -> Symmetric6:
        """Return the inertia at the parent's point."""
        I = self.inertia.dense()
        return symmetric6(I - self.G @ (I @ self.motion.H).T).inertia_shifted(self.motion.reach)

    def load_on_parent(self, load: Array, torque: Array) -> Array:
        """Return the load (6,) at the parent's point; arguments as in `nu`."""
        return shift_wrench(self.motion.reach, load + self.G @ (torque - self.motion.H.T @ load))


def settled_body(motion: BodyMotion, inertia: Symmetric6, *, alone: bool) -> SettledBody:
    """Return the response of a body's joint.

    Args:
        motion: the body.
        inertia: I(k), with everything that hangs on it.
        alone: whether nothing hangs on it.
    """
    if alone and motion.free is not None:
        d = array(motion.free.D)
        unused = MaskedLDL(np.eye(6), 1.0 / d, d, 6, 1.0)
        return SettledBody(motion, unused, array(motion.free.w).T, np.eye(6), inertia, motion.free)
    H, I = motion.H, inertia.dense()
    IH = I @ H
    D = I if motion.floats else H.T @ IH + np.diag(motion.armature)
    # the inertia of a free body is positive definite: every pivot counts, as does a single one
    size = np.zeros(len(D)) if motion.floats or len(D) == 1 else np.diag(D)
    factors = ldl(D, size, LEAST_PIVOT)
    columns = H @ back_substitution(factors.L, np.eye(len(D)))
    G = np.eye(6) if motion.floats else ldl_solve(factors, IH.T).T
    return SettledBody(motion, factors, columns, G, inertia, None)


@dataclass
class Settling:
    """The bodies of a forest while they settle, from the outermost inward.

    Attributes:
        motion: the forest's motion.
        inertia: by body, I(k) of what has settled on it so far.
        loaded: the bodies on which something hangs.
        bodies: those that have settled.
    """

    motion: ForestMotion
    inertia: dict[int, Symmetric6]
    loaded: set[int] = field(default_factory=set)
    bodies: dict[int, SettledBody] = field(default_factory=dict)

    @staticmethod
    def of(motion: ForestMotion) -> Settling:
        """Return the bodies outside limbs before any has settled, with the inertias of the limbs on them."""
        found = Settling(motion, {k: b.inertia for k, b in enumerate(motion.bodies) if b is not None})
        for limb in motion.all_limbs:
            base = limb.tip.base
            if base is not None:
                found.add(limb.on, base.locked.moved(np.eye(3), limb.offset).symmetric())
                if len(base.Y) == 6:  # otherwise they belong to joint rates (`crossing`)
                    found.add(limb.on, symmetric6(base.Y))
        return found

    def add(self, k: int, inertia: Symmetric6) -> None:
        """Let an inertia settle on a body."""
        self.inertia[k] = self.inertia[k].plus(inertia)
        self.loaded.add(k)

    def settle(self, k: int) -> SettledBody:
        """Let a body settle at its parent; return it."""
        body = settled_body(self.motion.bodies[k], self.inertia[k], alone=k not in self.loaded)
        self.bodies[k], parent = body, self.motion.topology.parents[k]
        if parent != GROUND:
            self.add(parent, body.inertia_on_parent())
        return body
