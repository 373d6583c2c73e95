"""What is known of the object's acceleration while its arms are seen, body by body of a trunk."""

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


class LastUpdate(NamedTuple):
    """The update by the last arm that holds.

    Attributes:
        answer: beta (c,) of the trunk's columns, or None -> (6,) alpha(G), the external wrench on the object included,
            and (6,) the wrench of the arm on the object, about G.
        on_trunk: (c, 1 + c) [load | inertia] that the arm adds to what the trunk's columns feel, and the load of the
            external wrench through all arms; of a mounted arm.
        independent: as in `Update`.
    """

    answer: Callable[[Array | None], tuple[Array, Array]]
    on_trunk: Array | None
    independent: Array | None


class Belief(NamedTuple):
    """What is known of the object's acceleration when all arms further out have been seen.

    Attributes:
        x: (6, 1 + c) [x | X], alpha(G) = x + X beta; (6,) x where no trunk is left.
        P: the mobility that is left, (6, 6) or in factors.
        size: (3,) how mobile P is, for judging pivots.
        kept: rows of the constraint that are independent.
        weakest: the smallest pivot kept, relative to a typical one.
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

    def seen(self, m: Measurement, tolerance: float) -> tuple[Belief, Update]:
        """Return the belief after an arm, and its back-substitution. A rigid one adds in parallel while P is dense."""
        if m.parallel and not isinstance(self.P, FactoredMobility):
            x, P, update = rigid_update(self.x, self.P, m, self.size)
            size = minimum(self.size, size_at_centre(m.extent))
        else:
            x, P, update = row_updates(self.x, self.factors(), m, self.size, tolerance)
            size = self.size
        return Belief(x, P, size, self.kept + update.kept, minimum(self.weakest, update.weakest)), update

    def seen_last(self, m: Measurement, tolerance: float, w: Array) -> tuple[Belief, LastUpdate]:
        """Return the belief after the last arm, whose way back begins with the external wrench w on the object."""
        if m.parallel and not isinstance(self.P, FactoredMobility):
            end = terminal_update(self.x, self.P, m, self.size, w)
            return self.seen(m, tolerance)[0], LastUpdate(end.answer, end.on_trunk, None)
        after, update = self.seen(m, tolerance)
        by_w, on_trunk = after.factors().apply(w), update.on_trunk
        if on_trunk is not None:
            on_trunk = np.column_stack([on_trunk[:, 0] - w @ after.x[:, 1:], on_trunk[:, 1:]])

        def answer(beta: Array | None) -> tuple[Array, Array]:
            return of_beta(after.x, beta) + by_w, update.back_substitute(w, beta)

        return after, LastUpdate(answer, on_trunk, update.independent)

    def released(self, D: list[Scalar], w: list[Array]) -> Belief:
        """Return the belief with P += sum D w w^T."""
        size = self.size
        for d, column in zip(D, w, strict=True):
            turning, moving = d * (column[:3] @ column[:3]), d * (column[3:] @ column[3:])
            size = size + array([turning, moving, moving])
        if isinstance(self.P, FactoredMobility):
            return self._replace(P=self.P.plus(D, w), size=size)
        W = array(w).T
        return self._replace(P=mirrored(self.P + (W * array(D)) @ W.T), size=size)
