"""Simulation of a forest by the classical Runge-Kutta scheme, projected onto its closures after every step."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.tree.forest_closing import forest_close
from holdfast.dynamics.tree.forest_dynamics import forest_arguments, solved_forest
from holdfast.dynamics.tree.varied_forest import ForestArguments, displaced, position_rates
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.forest import Forest
from holdfast.names import called
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array

MOST_FOREST_STEPS = 100_000
ForestLaw = Callable[[float, Array, Array], ArrayLike]


@called
@dataclass(frozen=True, eq=False)
class ForestRun(Frozen):
    """A motion of a forest.

    Attributes:
        t: (steps + 1,) times [s].
        q: (steps + 1, n_q) positions.
        qd: (steps + 1, n_v) rates.
    """

    t: Array
    q: Array
    qd: Array


@np.errstate(all="ignore")  # what overflows is refused
def forest_simulate(
    forest: Forest,
    q: ArrayLike,
    qd: ArrayLike,
    torque: ForestLaw | None = None,
    *,
    duration: float,
    step: float,
) -> ForestRun:
    """Return a motion of a forest in fixed steps, O(n) per step as `forest_dynamics`.

    The scheme has fourth order. After every step, positions and rates are brought back to closures and couplings
    (`forest_close`), which takes O(n^3).

    Args:
        forest: bodies, closures and couplings.
        q: (n_q,) positions at the start.
        qd: (n_v,) rates at the start.
        torque: function of time [s], q and qd that returns (n_v,) torques [N m or N]; None for none.
        duration: [s].
        step: the longest step [s]; a whole number of equal steps is taken.

    Raises:
        StateError: a shape is wrong, or the state violates a closure or a coupling.
        SingularChainError: no accelerations satisfy the closures.
        ClosureError: a step leaves the closures too far open.
    """
    given = forest_arguments(forest, q, qd)
    n = forest.velocity_count
    total, longest = checks.number(duration, "duration", above=0.0), checks.number(step, "step", above=0.0)
    if not total <= MOST_FOREST_STEPS * longest:
        raise StateError(f"step: expected at most {MOST_FOREST_STEPS} steps, got {total:g} s in steps of {longest:g} s")
    count = math.ceil(total / longest - 1e-9)
    h = total / count

    def slope(t: float, x: Array) -> Array:
        at = _unit_quaternions(forest, x[: forest.position_count])
        rates = x[forest.position_count :]
        tau = np.zeros(n) if torque is None else checks.numbers(torque(t, at, rates), (n,), "torque", StateError)
        found = solved_forest(ForestArguments(forest, at, rates, tau, given.wrenches), check=t == 0.0)[2]
        return np.concatenate([position_rates(forest, at, rates), found.qdd])

    q, qd = given.q, given.qd
    record = [(q, qd)]
    for k in range(count):
        x, t = np.concatenate([q, qd]), k * h
        a = slope(t, x)
        b = slope(t + 0.5 * h, x + 0.5 * h * a)
        c = slope(t + 0.5 * h, x + 0.5 * h * b)
        d = slope(t + h, x + h * c)
        x = x + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        closed = forest_close(forest, _unit_quaternions(forest, x[: len(q)]), x[len(q) :])
        q, qd = closed.q, closed.qd
        record.append((q, qd))
    return ForestRun(h * np.arange(count + 1), *(np.array(x) for x in zip(*record, strict=True)))


def _unit_quaternions(forest: Forest, q: Array) -> Array:
    """Return positions with quaternions of unit length."""
    return displaced(forest, q, np.zeros(forest.velocity_count))
