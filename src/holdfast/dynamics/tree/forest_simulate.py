"""Simulation of a forest by the classical Runge-Kutta scheme, projected onto its closures after every step."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.result import Status
from holdfast.dynamics.tree.forest_balance import power_into
from holdfast.dynamics.tree.forest_closing import forest_close
from holdfast.dynamics.tree.forest_dynamics import ForestResult, forest_arguments, solved_forest
from holdfast.dynamics.tree.forest_gaps import position_gaps
from holdfast.dynamics.tree.forest_motion import ForestMotion
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


class ForestStage(NamedTuple):
    """A forest at one time of a step.

    Attributes:
        given: its arguments, of which positions have unit quaternions.
        motion: its motion.
        result: its accelerations and forces.
        power: (4,) power of drives, dampers, bases and wrenches [W].
    """

    given: ForestArguments
    motion: ForestMotion
    result: ForestResult
    power: Array


class ForestSample(NamedTuple):
    """A forest at the end of a step.

    Attributes:
        t: time [s].
        stage: the forest, evaluated.
        work: (4,) work since the start, in the order of the power, by the same weights as the motion [J].
        drift: the largest position gap that the step left before it was closed [m and rad].
    """

    t: float
    stage: ForestStage
    work: Array
    drift: float


Acting = Callable[[float, Array, Array, bool], ForestArguments]  # of t, q, qd and whether a step begins


def stage_of(given: ForestArguments, check: bool) -> ForestStage:
    """Return a forest at one time, evaluated."""
    motion, _, result = solved_forest(given, check=check)
    return ForestStage(given, motion, result, np.array(power_into(given, motion)))


def forest_steps(forest: Forest, q: Array, qd: Array, acting: Acting, times: Array) -> Iterator[ForestSample]:
    """Yield a forest at given times, the first of which is the start; see `forest_simulate`.

    Where some rows follow from others, they contradict each other beside closed states. The stages of a step are then
    closed, too, which is the same scheme for accelerations that depend on the nearest closed state.

    Args:
        forest: the forest.
        q: (n_q,) positions at the start.
        qd: (n_v,) rates at the start.
        acting: returns the arguments of the forest at a time and state.
        times: (steps + 1,) increasing times [s].
    """
    n_q, n_v, work, drift = forest.position_count, forest.velocity_count, np.zeros(4), 0.0
    unique = True

    def evaluated(t: float, x: Array, begins: bool, check: bool = False) -> tuple[ForestStage, Array]:
        at, rates = _unit_quaternions(forest, x[:n_q]), x[n_q : n_q + n_v]
        if not (begins or unique):
            closed = forest_close(forest, at, rates)
            at, rates = closed.q, closed.qd
        found = stage_of(acting(t, at, rates, begins), check)
        return found, np.concatenate([position_rates(forest, at, rates), found.result.qdd, found.power])

    for k, t in enumerate(times.tolist()):
        x = np.concatenate([q, qd, work])
        now, a = evaluated(t, x, True, check=k == 0)
        unique = now.result.status is Status.OK
        yield ForestSample(t, now, work, drift)
        if k + 1 == len(times):
            return
        h = times[k + 1] - t
        _, b = evaluated(t + 0.5 * h, x + 0.5 * h * a, False)
        _, c = evaluated(t + 0.5 * h, x + 0.5 * h * b, False)
        _, d = evaluated(t + h, x + h * c, False)
        x = x + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        moved = _unit_quaternions(forest, x[:n_q])
        closed = forest_close(forest, moved, x[n_q : n_q + n_v])
        q, qd, work = closed.q, closed.qd, x[n_q + n_v :]
        drift = position_gaps(now.given._replace(q=moved).motion({}), moved).largest


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

    def acting(t: float, at: Array, rates: Array, begins: bool) -> ForestArguments:
        tau = np.zeros(n) if torque is None else checks.numbers(torque(t, at, rates), (n,), "torque", StateError)
        return ForestArguments(forest, at, rates, tau, given.wrenches)

    samples = [*forest_steps(forest, given.q, given.qd, acting, h * np.arange(count + 1))]
    reached = [(sample.stage.given.q, sample.stage.given.qd) for sample in samples]
    return ForestRun(np.array([sample.t for sample in samples]), *(np.array(x) for x in zip(*reached, strict=True)))


def _unit_quaternions(forest: Forest, q: Array) -> Array:
    """Return positions with quaternions of unit length."""
    return displaced(forest, q, np.zeros(forest.velocity_count))
