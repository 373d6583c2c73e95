"""Across the joints of a trunk, inward: one by one, all at once, or a floating base.

With the inertia I and the wrench z that a body feels of everything there and further out, W = X H:

    D = H^T I H + armature,  G = I H / D,  eps = tau' - H^T z;   a = (eps + W^T s) / D - G^T phi^T beta
    P += W D^-1 W^T,   x += W eps / D,   X <- (X - W G^T) phi^T

Where the columns are the joints' accelerations they are crossed at once, D being their mass matrix and G = 0, W = X; so
is a floating base, whose columns are all of its acceleration: D = I, eps = -z.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.trunk.belief import Belief
from holdfast.dynamics.trunk.trunk_motion import TrunkBody
from holdfast.spatial.inertia import NO_INERTIA as NO_BODY
from holdfast.spatial.inertia import RigidInertia
from holdfast.spatial.linalg import forward_substitution, ldl, ldl_solve
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, maximum, where
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench
from holdfast.spatial.symmetric import mirrored, symmetric6
from holdfast.spatial.vector import outer

NO_INERTIA = 1e-14  # of the largest inertia about a joint of the trunk: what is left is rounding


class Welded(NamedTuple):
    """A body of the trunk with its arms, their joints locked, about its origin.

    Attributes:
        inertia: of all of them.
        wrench: (6,) that they need at rest.
    """

    inertia: RigidInertia
    wrench: Array

    def plus(self, other: Welded) -> Welded:
        """Return both together."""
        return Welded(self.inertia.plus(other.inertia), self.wrench + other.wrench)

    def moved(self, offset: Array) -> Welded:
        """Return the same about another point of the body, `offset` from there to the point before [m]."""
        return Welded(self.inertia.moved(np.eye(3), offset), shift_wrench(offset, self.wrench))


class Felt(NamedTuple):
    """What the trunk's columns feel besides: joints of arms that are free, grasps, and everything further out.

    Attributes:
        load: (c,).
        inertia: (c, c), symmetric.
    """

    load: Array
    inertia: Array

    def plus(self, load: Array, inertia: Array) -> Felt:
        """Return the sum."""
        return Felt(self.load + load, mirrored(self.inertia + inertia))


class Crossing(NamedTuple):
    """A joint of the trunk, several, or its floating base, on the way back.

    Attributes:
        belief: after it.
        felt: by the body before.
        accelerated: beta of the body before (6,), s (6,) -> accelerations of the joints or of the floating base, and
            of the columns.
        pivots: inertias about the joints; the smallest pivot of a floating base's, relative to its size.
    """

    belief: Belief
    felt: Felt
    accelerated: Callable[[Array, Array], tuple[Array, Array]]
    pivots: Array


def nothing_felt(columns: int) -> Felt:
    """Return what nobody adds."""
    return Felt(np.zeros(columns), np.zeros((columns, columns)))


def joint_crossed(body: TrunkBody, welded: Welded, belief: Belief, felt: Felt) -> Crossing:
    """Return one joint crossed; see the module's equations."""
    assert body.H is not None and body.joint is not None
    H, x, X = body.H, belief.x[:, 0], belief.x[:, 1:]
    inertia, wrench = welded.inertia.symmetric().plus(symmetric6(felt.inertia)), welded.wrench + felt.load
    column = inertia.apply(H)
    D = H @ column + body.joint.armature
    G, eps, W = column / D, body.torque - H @ wrench, X @ H
    before = array([shift_wrench(body.reach, row) for row in X - outer(W, G)])  # times phi^T
    seen = belief.released([1.0 / D], [W])._replace(x=np.column_stack([x + W * (eps / D), before]))
    carried = Felt(
        shift_wrench(body.reach, wrench + G * eps), inertia.plus_outer(-G, column).inertia_shifted(body.reach).dense()
    )

    def accelerated(beta: Array, s: Array) -> tuple[Array, Array]:
        moving = shift_twist(body.reach, beta)
        a = (eps + W @ s) / D - G @ moving
        return array([a]), moving + a * H

    return Crossing(seen, carried, accelerated, array([D]))


def joints_crossed(bodies: Sequence[TrunkBody], welded: Sequence[Welded], belief: Belief, felt: Felt) -> Crossing:
    """Return all joints crossed at once, where the columns are their accelerations.

    Outermost first, the pivots are the inertias about the joints as they are met one by one.
    """
    M, T = joint_equations(bodies, welded)
    D, eps = (M + felt.inertia)[::-1, ::-1], (T - felt.load)[::-1]
    x, X = belief.x[:, :1], belief.x[:, 1:]
    found = _released(belief._replace(x=np.hstack([x, X[:, ::-1]])), D, eps)
    largest: Scalar = 0.0
    for pivot in found.pivots:
        largest = maximum(largest, pivot)

    def accelerated(beta: Array, s: Array) -> tuple[Array, Array]:
        qdd = found.accelerated(beta, s)[0][::-1]
        first = qdd[0]
        for pivot in found.pivots:
            first = where(pivot > NO_INERTIA * largest, first, float("nan"))
        qdd = concatenate([[first], qdd[1:]])
        return qdd, qdd

    return found._replace(accelerated=accelerated, pivots=found.pivots[::-1])


def joint_equations(bodies: Sequence[TrunkBody], welded: Sequence[Welded]) -> tuple[Array, Array]:
    """Return mass matrix (n_t, n_t), and torques less bias torques (n_t,), of joints under welded bodies. O(n_t^2)."""
    n = len(bodies)
    M: list[list[Scalar]] = [[0.0] * n for _ in range(n)]
    T: list[Scalar] = [0.0] * n
    carried = Welded(NO_BODY, np.zeros(6))
    for k in reversed(range(n)):
        body, carried = bodies[k], carried.plus(welded[k])
        assert body.H is not None and body.joint is not None
        F = carried.inertia.apply(body.H)
        M[k][k] = body.H @ F + body.joint.armature
        T[k] = body.torque - body.H @ carried.wrench
        for j in reversed(range(k)):
            F = shift_wrench(bodies[j + 1].reach, F)
            M[j][k] = M[k][j] = bodies[j].H @ F
        carried = carried.moved(body.reach)
    return array(M), array(T)


def set_free(welded: Welded, belief: Belief, felt: Felt) -> Crossing:
    """Return a floating base released."""
    D = welded.inertia.symmetric().dense() + felt.inertia
    return _released(belief, D, -(welded.wrench + felt.load))


def _released(belief: Belief, D: Array, eps: Array) -> Crossing:
    """Return the columns released, which have the inertia D and the drives eps."""
    x, X = belief.x[:, 0], belief.x[:, 1:]
    factors = ldl(D, np.zeros(len(D)))  # positive definite: every pivot counts
    columns = forward_substitution(factors.L, X.T)  # L^-1 X^T
    seen = belief.released([1.0 / d for d in factors.pivots], list(columns))
    seen = seen._replace(x=(x + X @ ldl_solve(factors, eps))[:, None])

    def accelerated(_: Array, s: Array) -> tuple[Array, Array]:
        a = ldl_solve(factors, eps + s @ X)
        return a, a

    return Crossing(seen, nothing_felt(6), accelerated, factors.pivots)
