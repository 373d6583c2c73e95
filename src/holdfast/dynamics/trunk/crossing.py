"""The state of the filter, and its step across the joints of a trunk or a floating base.

The step goes inward, across one joint or all joints together. With the inertia I and the wrench z of everything on a
body and further out, and W = X H:

    D = H^T I H + armature,  G = I H / D,  eps = tau' - H^T z;   a = (eps + W^T s) / D - G^T phi^T beta
    P += W D^-1 W^T,   x += W eps / D,   X <- (X - W G^T) phi^T

If the columns are the accelerations of the joints, all joints are crossed together: D is their mass matrix, G = 0 and
W = X. For a floating base, whose columns are all components of its acceleration, D = I and eps = -z.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.closed.factored_mobility import FactoredMobility, factored
from holdfast.dynamics.closed.filter_updates import ParallelSum, RowSums, parallel_sum, row_sums, terminal_sum
from holdfast.dynamics.closed.measurement import Measurement, size_at_centre
from holdfast.dynamics.closed.object_filter import sizes_of_rows
from holdfast.dynamics.closed.tip_response import LEAST_INERTIA
from holdfast.dynamics.trunk.trunk_motion import TrunkBody
from holdfast.spatial.inertia import NO_INERTIA, RigidInertia
from holdfast.spatial.linalg import forward_substitution, ldl, ldl_solve
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, maximum, minimum, where
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench
from holdfast.spatial.symmetric import mirrored, symmetric6
from holdfast.spatial.vector import outer


class ArmUpdate(NamedTuple):
    """The update by an arm with a grasp.

    Attributes:
        factors: its factors.
        nu: what the way back needs.
        load: (c,) load that its grasp adds to the equations of the trunk's columns.
        inertia: (c, c) inertia that it adds.
        independent: as in `Included`.
    """

    factors: ParallelSum | RowSums
    nu: Any
    load: Array
    inertia: Array
    independent: Array | None


class FinalUpdate(NamedTuple):
    """The update by the last arm with a grasp, after which only back-substitution follows.

    Attributes:
        solution: function of beta (c,) for the trunk's columns that returns alpha(G) (6,), which includes the effect of
            the external wrench on the object, and the wrench (6,) of the arm on the object, about G.
        load, inertia, independent: as in `ArmUpdate`, including the load of the external wrench through all arms.
    """

    solution: Callable[[Array], tuple[Array, Array]]
    load: Array
    inertia: Array
    independent: Array | None


class FilterState(NamedTuple):
    """The state of the filter after all arms on the bodies further out have been included.

    Attributes:
        x: (6,) x with alpha(G) = x + X beta.
        X: (6, c); (6, 0) after the trunk.
        P: the remaining mobility, (6, 6) or in factors.
        size: (3,) size of P, for judging pivots.
        kept: number of independent rows of the constraint.
        weakest: the smallest pivot of these rows, relative to a typical one.
    """

    x: Array
    X: Array
    P: Array | FactoredMobility
    size: Array
    kept: Scalar
    weakest: Scalar

    def dense(self) -> Array:
        """Return P, (6, 6)."""
        return self.P.dense() if isinstance(self.P, FactoredMobility) else self.P

    def factors(self) -> FactoredMobility:
        """Return P in factors."""
        return self.P if isinstance(self.P, FactoredMobility) else factored(self.P, sizes_of_rows(self.size))

    def updated(self, m: Measurement, tolerance: float) -> tuple[FilterState, ArmUpdate]:
        """Return the state after the update by an arm, and the update, by a parallel sum if possible."""
        if m.parallel and not isinstance(self.P, FactoredMobility):
            included, factors = parallel_sum(self.X, self.P, m, self.size)
            size = minimum(self.size, size_at_centre(m.extent))
        else:
            included, factors = row_sums(
                self.X, self.factors(), m, m.pivot_sizes(self.size), m.typical_pivots(self.size), tolerance
            )
            size = self.size
        x, load, nu = factors.forward(self.x, m.r)
        kept, weakest = self.kept + included.kept, minimum(self.weakest, included.weakest)
        update = ArmUpdate(factors, nu, load, included.N, included.independent)
        return FilterState(x, included.X, included.P, size, kept, weakest), update

    def updated_by_final(self, m: Measurement, tolerance: float, w: Array) -> tuple[FilterState, FinalUpdate]:
        """Return the state after the update by the last arm, and its update; w is the external wrench on the object."""
        after, update = self.updated(m, tolerance)
        if m.parallel and not isinstance(self.P, FactoredMobility):
            included, end = terminal_sum(self.X, self.P, m, self.size)
            load, kept = end.forward(self.x, m.r, w)
            return after, FinalUpdate(lambda beta: end.back(kept, beta), load, included.N, None)
        by_w = after.factors().apply(w)

        def solution(beta: Array) -> tuple[Array, Array]:
            return after.x + after.X @ beta + by_w, update.factors.back(w, update.nu, beta)

        return after, FinalUpdate(solution, update.load - w @ after.X, update.inertia, update.independent)

    def released(self, D: list[Scalar], w: list[Array]) -> FilterState:
        """Return the state with sum D w w^T added to P."""
        size = self.size
        for d, column in zip(D, w, strict=True):
            turning, moving = d * (column[:3] @ column[:3]), d * (column[3:] @ column[3:])
            size = size + array([turning, moving, moving])
        if isinstance(self.P, FactoredMobility):
            return self._replace(P=self.P.plus(D, w), size=size)
        W = array(w).T
        return self._replace(P=mirrored(self.P + (W * array(D)) @ W.T), size=size)


class LockedBody(NamedTuple):
    """A body of the trunk together with its arms, whose joints are locked, about its origin.

    Attributes:
        inertia: total inertia.
        wrench: (6,) total bias wrench.
    """

    inertia: RigidInertia
    wrench: Array

    def plus(self, other: LockedBody) -> LockedBody:
        """Return the sum of both."""
        return LockedBody(self.inertia.plus(other.inertia), self.wrench + other.wrench)

    def moved(self, offset: Array) -> LockedBody:
        """Return the quantities about another point of the body; `offset` leads from there to the present point [m]."""
        return LockedBody(self.inertia.moved(np.eye(3), offset), shift_wrench(offset, self.wrench))


class CarriedTerms(NamedTuple):
    """Additional terms in the equations of the trunk's columns: free joints of arms, grasps, and bodies further out.

    Attributes:
        load: (c,) load on the columns.
        inertia: (c, c) symmetric inertia of the columns.
    """

    load: Array
    inertia: Array

    def plus(self, load: Array, inertia: Array) -> CarriedTerms:
        """Return the terms with a load and an inertia added."""
        return CarriedTerms(self.load + load, mirrored(self.inertia + inertia))


class Crossing(NamedTuple):
    """The result of crossing one or several joints of the trunk, or its floating base.

    Attributes:
        filter_state: the state of the filter after crossing.
        carried: the additional terms for the body before.
        accelerated: function of beta (6,) of the body before and of s (6,) that returns the accelerations of the joints
            or of the floating base, and those of the columns.
        pivots: inertias about the joints; for a floating base the smallest pivot, relative to its size.
    """

    filter_state: FilterState
    carried: CarriedTerms
    accelerated: Callable[[Array, Array], tuple[Array, Array]]
    pivots: Array


def nothing_carried(columns: int) -> CarriedTerms:
    """Return zero additional terms."""
    return CarriedTerms(np.zeros(columns), np.zeros((columns, columns)))


def joint_crossed(body: TrunkBody, welded: LockedBody, filter_state: FilterState, carried: CarriedTerms) -> Crossing:
    """Return the result of crossing one joint; see the equations of the module."""
    assert body.H is not None and body.joint is not None
    H, x, X = body.H, filter_state.x, filter_state.X
    inertia, wrench = welded.inertia.symmetric().plus(symmetric6(carried.inertia)), welded.wrench + carried.load
    column = inertia.apply(H)
    D = H @ column + body.joint.armature
    G, eps, W = column / D, body.torque - H @ wrench, X @ H
    before = array([shift_wrench(body.reach, row) for row in X - outer(W, G)])  # times phi^T
    updated = filter_state.released([1.0 / D], [W])._replace(x=x + W * (eps / D), X=before)
    carried = CarriedTerms(
        shift_wrench(body.reach, wrench + G * eps), inertia.plus_outer(-G, column).inertia_shifted(body.reach).dense()
    )

    def accelerated(beta: Array, s: Array) -> tuple[Array, Array]:
        moving = shift_twist(body.reach, beta)
        a = (eps + W @ s) / D - G @ moving
        return array([a]), moving + a * H

    return Crossing(updated, carried, accelerated, array([D]))


def joints_crossed(
    bodies: Sequence[TrunkBody], welded: Sequence[LockedBody], filter_state: FilterState, carried: CarriedTerms
) -> Crossing:
    """Return the result of crossing all joints together, if the columns are their accelerations.

    The joints are eliminated from the outermost inward, so the pivots are the inertias about the joints.
    """
    M, T = joint_equations(bodies, welded)
    D, eps = (M + carried.inertia)[::-1, ::-1], (T - carried.load)[::-1]
    found = _released(filter_state._replace(X=filter_state.X[:, ::-1]), D, eps)
    largest = reduce(maximum, found.pivots, 0.0)

    def accelerated(beta: Array, s: Array) -> tuple[Array, Array]:
        qdd = found.accelerated(beta, s)[0][::-1]
        first = qdd[0]
        for pivot in found.pivots:
            first = where(pivot > LEAST_INERTIA * largest, first, float("nan"))
        qdd = concatenate([[first], qdd[1:]])
        return qdd, qdd

    return found._replace(accelerated=accelerated, pivots=found.pivots[::-1])


def joint_equations(bodies: Sequence[TrunkBody], welded: Sequence[LockedBody]) -> tuple[Array, Array]:
    """Return the mass matrix (n_t, n_t) and the torques minus bias torques (n_t,) of the trunk's joints. O(n_t^2)."""
    n = len(bodies)
    M: list[list[Scalar]] = [[0.0] * n for _ in range(n)]
    T: list[Scalar] = [0.0] * n
    carried = LockedBody(NO_INERTIA, np.zeros(6))
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


def set_free(welded: LockedBody, filter_state: FilterState, carried: CarriedTerms) -> Crossing:
    """Return the result of crossing a floating base."""
    D = welded.inertia.symmetric().dense() + carried.inertia
    return _released(filter_state, D, -(welded.wrench + carried.load))


def _released(filter_state: FilterState, D: Array, eps: Array) -> Crossing:
    """Return the result of eliminating the columns, with their inertia D and generalised forces eps."""
    x, X = filter_state.x, filter_state.X
    factors = ldl(D, np.zeros(len(D)))  # positive definite: every pivot counts
    columns = forward_substitution(factors.L, X.T)  # L^-1 X^T
    updated = filter_state.released([1.0 / d for d in factors.pivots], list(columns))
    updated = updated._replace(x=x + X @ ldl_solve(factors, eps), X=np.zeros((6, 0)))

    def accelerated(_: Array, s: Array) -> tuple[Array, Array]:
        a = ldl_solve(factors, eps + s @ X)
        return a, a

    return Crossing(updated, nothing_carried(6), accelerated, factors.pivots)
