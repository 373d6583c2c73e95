"""The state of the object's filter, the estimate of the object's acceleration and its mobility, on its way inward."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.factored_mobility import FactoredMobility, factored
from holdfast.dynamics.closed.measurement import Measurement, Update, of_beta, size_at_centre
from holdfast.dynamics.closed.object_filter import sizes_of_rows
from holdfast.dynamics.closed.rigid_update import rigid_update, terminal_update
from holdfast.dynamics.closed.row_updates import row_updates
from holdfast.spatial.scalar import Array, Scalar, array, minimum
from holdfast.spatial.symmetric import mirrored


class FinalUpdate(NamedTuple):
    """The update by the last arm with a grasp, after which only back-substitution follows.

    Attributes:
        solution: function of beta (c,) for the trunk's columns, or None, that returns alpha(G) (6,), which includes the
            effect of the external wrench on the object, and the wrench (6,) of the arm on the object, about G.
        on_trunk: for a mounted arm, (c, 1 + c) [load | inertia] that it adds to the equations of the trunk's columns,
            including the load of the external wrench through all arms.
        independent: as in `Update`.
    """

    solution: Callable[[Array | None], tuple[Array, Array]]
    on_trunk: Array | None
    independent: Array | None


class FilterState(NamedTuple):
    """The state of the filter after all arms on the bodies further out have been included.

    Attributes:
        x: (6, 1 + c) [x | X] with alpha(G) = x + X beta; (6,) x after the trunk.
        P: the remaining mobility, (6, 6) or in factors.
        size: (3,) size of P, for judging pivots.
        kept: number of independent rows of the constraint.
        weakest: the smallest pivot of these rows, relative to a typical one.
    """

    x: Array
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

    def updated(self, m: Measurement, tolerance: float) -> tuple[FilterState, Update]:
        """Return the state after the update by an arm, and its back-substitution, by a parallel sum if possible."""
        if m.parallel and not isinstance(self.P, FactoredMobility):
            x, P, update = rigid_update(self.x, self.P, m, self.size)
            size = minimum(self.size, size_at_centre(m.extent))
        else:
            x, P, update = row_updates(self.x, self.factors(), m, self.size, tolerance)
            size = self.size
        return FilterState(x, P, size, self.kept + update.kept, minimum(self.weakest, update.weakest)), update

    def updated_by_final(self, m: Measurement, tolerance: float, w: Array) -> tuple[FilterState, FinalUpdate]:
        """Return the state after the update by the last arm, and its update; w is the external wrench on the object."""
        if m.parallel and not isinstance(self.P, FactoredMobility):
            end = terminal_update(self.x, self.P, m, self.size, w)
            return self.updated(m, tolerance)[0], FinalUpdate(end.solution, end.on_trunk, None)
        after, update = self.updated(m, tolerance)
        by_w, on_trunk = after.factors().apply(w), update.on_trunk
        if on_trunk is not None:
            on_trunk = np.column_stack([on_trunk[:, 0] - w @ after.x[:, 1:], on_trunk[:, 1:]])

        def solution(beta: Array | None) -> tuple[Array, Array]:
            return of_beta(after.x, beta) + by_w, update.back_substitute(w, beta)

        return after, FinalUpdate(solution, on_trunk, update.independent)

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
