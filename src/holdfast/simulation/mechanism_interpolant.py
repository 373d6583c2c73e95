"""Interpolation of the motion of a forest between two instants by quintics."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from holdfast.dynamics.tree.varied_forest import position_rates, rates_of_positions, unit_quaternions
from holdfast.model.forest import Forest
from holdfast.simulation.interpolant import quintic
from holdfast.spatial.scalar import Array


class ForestKnot(NamedTuple):
    """An end point of an interpolating quintic.

    Attributes:
        t: time [s].
        q: (n_q,) positions.
        qd: (n_v,) rates.
        qdd: (n_v,) accelerations.
    """

    t: float
    q: Array
    qd: Array
    qdd: Array


def forest_interpolant(forest: Forest, now: ForestKnot, later: ForestKnot) -> Callable[[float], tuple[Array, Array]]:
    """Return positions (n_q,) and rates (n_v,) as a function of time between two knots.

    Orders are those of `interpolant`; quaternions are interpolated as four numbers, which are of the same sign at both
    knots, and scaled to unit length.
    """
    step = later.t - now.t
    ends = [_motion(forest, at) for at in (now, later)]

    def at(t: float) -> tuple[Array, Array]:
        x, rate = quintic(*ends[0], *ends[1], step, (t - now.t) / step)
        return unit_quaternions(forest, x), rates_of_positions(forest, x, rate)

    return at


def _motion(forest: Forest, at: ForestKnot) -> tuple[Array, Array, Array]:
    """Return positions, dq/dt and its rate, (n_q,) each; dq/dt is linear in qd, and in the quaternions."""
    rate = position_rates(forest, at.q, at.qd)
    of_turning = position_rates(forest, rate, at.qd) - position_rates(forest, 0.0 * at.q, at.qd)
    return at.q, rate, position_rates(forest, at.q, at.qdd) + of_turning
