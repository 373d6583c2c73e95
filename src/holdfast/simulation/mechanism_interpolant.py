"""Interpolation of the motion of a forest between two instants by quintics."""

from __future__ import annotations

from typing import NamedTuple, Self

from holdfast.dynamics.tree.varied_forest import position_rates
from holdfast.model.forest import Forest
from holdfast.simulation.interpolant import quintic
from holdfast.spatial.scalar import Array


class ForestKnot(NamedTuple):
    """An end point of an interpolating quintic.

    Attributes:
        t: time [s].
        q: (n_q,) positions.
        rates: (n_q,) dq/dt.
        changes: (n_q,) d^2q/dt^2.
    """

    t: float
    q: Array
    rates: Array
    changes: Array

    @classmethod
    def of(cls, forest: Forest, t: float, q: Array, qd: Array, qdd: Array) -> Self:
        """Return the knot of a motion with rates and accelerations (n_v,); dq/dt is linear in qd and in quaternions."""
        rates, alone = position_rates(forest, q, qd), position_rates(forest, 0.0 * q, qd)
        return cls(t, q, rates, position_rates(forest, q, qdd) + position_rates(forest, rates, qd) - alone)

    def until(self, later: ForestKnot, s: float | Array) -> tuple[Array, Array]:
        """Return q and dq/dt at fractions s of the step to a later knot, (n_q,) each, or (k, n_q) for s (k, 1).

        Orders are those of `interpolant`. Quaternions are interpolated as four numbers, which are of the same sign at
        both knots, and are not of unit length; see `unit_quaternions` and `rates_of_positions`.
        """
        return quintic(*self[1:], *later[1:], later.t - self.t, s)
