"""Verification of the margins inside a step: the time of a violation is located to 1e-12 s, its depth to rounding.

The margins are known at the step's start. They are also evaluated after every eighth of the step and at the stage times
of the scheme. Each of these points is reached by one shorter step from the start (in parts, if `SubdividingStepper`
divides it), never by an interpolant. A controller that is a Python function and is not sampled is called at the stages
of the step only: at those points its torques are those of a quadratic through its answers, and it is called for a
margin that may be negative (`rollout.python_law_stepper`). What such a function does between two stages is neither part
of the motion nor verified. Chains that are answered as forests, if their steps are not machine code as a whole, are
first looked at on quintics through the ends of the step, under such torques; of controllers that are no `ControlLaw`
what is between the stages is not verified either.

*Every dip below zero that lasts a quarter of a step is certain to be found.* The evaluations are at most h/8 apart,
also across steps, so any interval of length h/4 contains at least two of them, and a dip of any shape appears as a
negative margin. If steps end at the knots and turning points of a torque schedule and at declared breakpoints, the
margins are smooth within a step, and *shorter dips* appear as a minimum between the evaluations:

* Three evaluations of which the middle one is lowest bracket a minimum. It is refined if it could be negative, or lower
  than any margin before in the run. The left neighbour of the step's start is the last evaluation of the previous step.
* If a margin falls towards the step's end, or rises from its start, so steeply that it may have been negative in
  between, the last or first eighth of the step is evaluated in eighths.

At the beginning and end of a smooth stretch (at a knot or an event) there is no evaluation beyond, and only the second
rule applies to the outermost eighth. In both rules a minimum "could be" as low as two drops below the lowest
evaluation, where a drop is the difference to its higher neighbour. For a parabola the minimum is at most 1/8 of a drop
below, and for two straight lines at most one drop. A margin is the minimum of several functions (the conditions of a
contact, both ends of a range) or a limit minus an absolute value. Where another of these functions becomes the
smallest, its slope decreases, so minima lie where the margin is smooth; the searches do not rely on this.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from holdfast.errors import ClosureError, HoldfastError, SingularChainError, StateError
from holdfast.simulation.bracket import crossing, search_lowest, together
from holdfast.simulation.instant import Instant
from holdfast.simulation.stepper import NO_GAPS, Advance
from holdfast.spatial.scalar import Array

EVALUATIONS = 8  # evaluations per step, besides the stage times
DROPS = 2.0
FLAT = 1e-9  # relative, or absolute below 1: a smaller drop is rounding
TIME_OF_MINIMUM = 1e-7  # precision of the time of a minimum, as a fraction of the step
CROSSING = 1e-13  # [s]: precision of the time of a zero
PAST_JUMP = 4.0 * CROSSING  # [s]: steps across jumps
JUMP = 1e-6  # relative, or absolute below 1: by so much a margin changes within the precision of a zero

Reach = Callable[[Sequence[float]], list[Advance]]
REFUSALS = (SingularChainError, ClosureError, StateError)


class StepMargins(NamedTuple):
    """The margins evaluated in a step, and its end.

    Attributes:
        times: (k,) times of the evaluations in order; the first belongs to the previous step, if there is one.
        margins: (k, signals) margins at these times.
        start: index of the step's start in `times`.
        end: the end of the step, which is the requested one or the first at which an acting margin is negative.
    """

    times: Array
    margins: Array
    start: int
    end: Advance


@dataclass(frozen=True, eq=False)
class MarginCurves:
    """The margins as functions of time around an accepted instant; evaluations are stored and reused.

    Attributes:
        reach: takes single steps from the instant to given times.
        of: returns all margins at several instants, (instants, signals).
        margins: margins by time, as far as they have been evaluated.
        advances: results of the steps by time, for the times of this step.
    """

    reach: Reach
    of: Callable[[Sequence[Instant]], Array]
    margins: dict[float, Array]
    advances: dict[float, Advance]

    def evaluate(self, times: Sequence[float]) -> None:
        """Evaluate the margins at several times.

        Raises:
            HoldfastError: the error of the first time that cannot be reached; the margins before it are kept.
        """
        found = self.reach([t for t in times if t not in self.margins])
        failed = next((k for k, reached in enumerate(found) if reached.instant is None), len(found))
        led = found[:failed]
        self.advances.update((reached.t, reached) for reached in led)
        instants = [reached.instant for reached in led if reached.instant is not None]
        if instants:
            self.margins.update(zip((reached.t for reached in led), self.of(instants), strict=True))
        if failed < len(found) and (failure := found[failed].failure) is not None:
            raise failure

    def signal(self, i: int) -> Callable[[float], float]:
        """Return one margin as a function of time, which raises the error of a step that fails."""

        def margin(t: float) -> float:
            self.evaluate([t])
            return float(self.margins[t][i])

        return margin

    def table(self) -> tuple[Array, Array]:
        """Return the times (k,) in order, and the margins at these times, (k, signals)."""
        times = np.array(sorted(self.margins))
        return times, np.array([self.margins[t] for t in times])


def evaluation_times(begin: float, end: float, nodes: Sequence[float]) -> list[float]:
    """Return the times after `begin` at which the margins of a step are evaluated; the last is `end`.

    Args:
        begin: start of the step [s].
        end: end of the step [s].
        nodes: stage times of the scheme, as fractions of a step.
    """
    inside = {begin + part * (end - begin) for part in evaluation_parts(nodes)}
    return [*sorted(t for t in inside if begin < t < end), end]


def evaluation_parts(nodes: Sequence[float]) -> list[float]:
    """Return the times inside a step at which its margins are evaluated, as fractions of the step, in order."""
    return sorted({k / EVALUATIONS for k in range(1, EVALUATIONS)} | {float(c) for c in nodes if 0.0 < c < 1.0})


def verify(
    curves: MarginCurves,
    begin: float,
    times: list[float],
    watched: Array,
    acting: Array,
    lowest: Array,
    of_modes: Sequence[int] = (),
) -> StepMargins:
    """Return the refined margins of a step, and the time at which it has to end.

    Args:
        curves: the margin curves, which contain the margins at the step's start and, if the margins are smooth there,
            those of the last evaluation before it.
        begin: the step's start [s].
        times: times to evaluate, from `evaluation_times`.
        watched: indices of the signals that have a limit.
        acting: indices of those that end the step when they become negative.
        lowest: (signals,) the lowest margins of the run so far.
        of_modes: those at whose zeros contacts change their modes; a step that finds a jump of one ends just before it,
            as the forces of fixed modes satisfy no law past it, and only the next, of at most `PAST_JUMP`, goes there.
    """
    failure: HoldfastError | None = None
    try:
        curves.evaluate(times)
    except HoldfastError as cause:
        failure = cause
    try:
        if failure is None:
            _evaluate_ends(curves, begin, watched)
            _refine_minima(curves, watched, lowest, TIME_OF_MINIMUM * (times[-1] - begin))
        zero = _first_zero(curves, begin, acting)
    except REFUSALS as cause:
        failure, zero = cause, None
    end = times[-1] if zero is None else _end(curves, begin, zero, of_modes)
    if zero is None and failure is not None:
        curves.advances[end] = Advance(end, None, NO_GAPS, np.zeros(4), failure=failure)
    found, margins = curves.table()
    kept = found <= end
    return StepMargins(found[kept], margins[kept], int(np.searchsorted(found, begin)), curves.advances[end])


def _end(curves: MarginCurves, begin: float, zero: float, of_modes: Sequence[int]) -> float:
    """Return the end of a step that finds a negative margin at a time: that time, or just before if it jumps there."""
    times, margins = curves.table()
    k, m = int(np.searchsorted(times, zero)), margins[:, of_modes]
    if zero - begin <= PAST_JUMP or times[k - 1] <= begin:
        return zero
    jumps = (m[k] < 0.0) & (m[k - 1] - m[k] > JUMP * np.maximum(1.0, np.ptp(m[:k], axis=0)))
    return float(times[k - 1]) if jumps.any() else zero


def verified_without_steps(
    between: MarginCurves, begin: float, times: list[float], watched: Array, beyond: Array, lowest: Array
) -> bool:
    """Refine the margins of a step on interpolated instants; return whether no violation may begin or end in it.

    Interpolated margins may be wrong, and there may be dips between them, by `DROPS` times the range that a margin has
    in the step.

    Args:
        between: the margin curves of interpolated instants, which contain the margins at the step's ends.
        begin: as for `verify`.
        times: as for `verify`.
        watched: as for `verify`.
        beyond: (signals,) whether a recorded violation goes on.
        lowest: as for `verify`.
    """
    try:
        between.evaluate(times)
        found, margins = between.table()
        if _doubtful(margins[found >= begin][:, watched], beyond[watched]):
            return False
        _refine_minima(between, watched, lowest, TIME_OF_MINIMUM * (times[-1] - begin))
    except REFUSALS:
        return False
    return True


def verified_by_screening(
    between: MarginCurves, begin: float, times: list[float], watched: Array, beyond: Array, lowest: Array
) -> bool:
    """Refine the margins of a step without calls of its Python functions; return whether none is in doubt.

    The arguments are those of `verified_without_steps`, with the instants of `PythonLawStepper.screened`.
    """
    try:
        between.evaluate(times)
        found, margins = between.table()
        m = margins[:, watched]
        if in_doubt(m[found >= begin], beyond[watched]) or len(may_be_negative(m)[0]):
            return False
        _refine_minima(between, watched, lowest, TIME_OF_MINIMUM * (times[-1] - begin))
    except REFUSALS:
        return False
    found, margins = between.table()
    return not changes(margins[:, watched], beyond[watched])


def without_events(times: Array, margins: Array, begin: float, watched: Array, beyond: Array, lowest: Array) -> bool:
    """Return whether interpolated margins show that no violation may begin or end in a step, and no minimum to refine.

    Args:
        times: (k,) times, the first of which belongs to the previous step, if there is one.
        margins: (k, signals) margins at these times.
        begin: as for `verify`.
        watched: as for `verify`.
        beyond: as for `verified_without_steps`.
        lowest: as for `verify`.
    """
    m = margins[:, watched]
    least = np.minimum(lowest[watched], m.min(axis=0))
    return not _doubtful(m[times >= begin], beyond[watched]) and not len(minima(m, least)[0])


def _doubtful(m: Array, beyond: Array) -> bool:
    """Return whether violations may begin or end in a step with interpolated margins (k, signals)."""
    low, high = m.min(axis=0), m.max(axis=0)
    doubt = DROPS * (high - low)
    return bool(np.where(beyond, high + doubt >= 0.0, low - doubt < 0.0).any())


def _evaluate_ends(curves: MarginCurves, begin: float, watched: Array) -> None:
    """Evaluate the first or last eighth of a step in eighths if a margin may be negative within it."""
    times, margins = curves.table()
    first = int(np.searchsorted(times, begin))
    m = margins[first:, watched]
    if len(m) < 3:
        return
    more = []
    for (a, b, c), (s, t) in (((0, 1, 2), (first, first + 1)), ((-1, -2, -3), (-2, -1))):
        if may_cross(m[a], m[b], m[c]).any():
            more += [times[s] + k / EVALUATIONS * (times[t] - times[s]) for k in range(1, EVALUATIONS)]
    curves.evaluate(sorted({float(t) for t in more} - {float(t) for t in times}))


def _refine_minima(curves: MarginCurves, watched: Array, lowest: Array, precision: float) -> None:
    """Refine, in a joint search, all bracketed minima that may be negative or lower than any margin before."""
    times, margins = curves.table()
    m = margins[:, watched]
    rows, signals = minima(m, np.minimum(lowest[watched], m.min(axis=0)))
    found = [(times[k : k + 3].tolist(), int(watched[i])) for k, i in zip(rows, signals, strict=True)]

    def margins_at(times_of: Mapping[int, float]) -> list[float]:
        curves.evaluate(sorted(set(times_of.values())))
        return [float(curves.margins[t][found[k][1]]) for k, t in times_of.items()]

    together([search_lowest(a, b, c, precision) for (a, b, c), _ in found], margins_at)


def may_cross(outer: Array, inner: Array, next_inner: Array) -> Array:
    """Return whether margins may be negative between the outermost evaluation of a step and the next one.

    Args:
        outer: margins at the step's start or end, of any shape; where they are negative, nothing has to be found.
        inner: those of the neighbouring evaluation.
        next_inner: those of the evaluation after that.
    """
    drop = inner - outer
    return (drop > 0.0) & (outer >= 0.0) & (outer < DROPS * np.maximum(drop, next_inner - inner))


def minima(m: Array, least: Array) -> tuple[Array, ...]:
    """Return the bracketed minima that may be negative or lower than any margin before.

    Args:
        m: (evaluations, ..., signals) margins at successive times, for one step or several.
        least: (..., signals) the lowest margins of the run up to the end of each step.

    Returns:
        For each minimum the number of the evaluation before the lowest one, then its places in `least`.
    """
    change = np.diff(m, axis=0)
    fall, rise = change[:-1], change[1:]
    bent = (fall <= 0.0) & (rise >= 0.0) & ((fall < -FLAT) | (rise > FLAT))
    row, *where = np.unravel_index(np.flatnonzero(bent), bent.shape)
    lowest, drop = m[row + 1, *where], np.maximum(-fall[row, *where], rise[row, *where])
    sizes = np.maximum(1.0, np.abs(lowest))
    possible = lowest - DROPS * drop
    deep = (possible < least[*where] - FLAT * sizes) | ((lowest >= 0.0) & (possible < 0.0))
    found = (drop > FLAT * sizes) & deep
    return row[found], *(places[found] for places in where)


def may_be_negative(m: Array) -> tuple[Array, ...]:
    """Return the bracketed minima of margins (evaluations, ..., signals) that may be negative, as `minima` does."""
    return minima(m, np.full(m.shape[1:], -np.inf))


def changes(m: Array, beyond: Array) -> Array:
    """Return whether violations begin or end among margins (evaluations, ..., signals), (...,).

    Args:
        m: margins at successive times, for one step or several.
        beyond: (signals,) whether a recorded violation goes on, in which a margin stays negative.
    """
    return ~np.where(beyond, m.max(axis=0) < 0.0, m.min(axis=0) >= 0.0).all(axis=-1)


def in_doubt(m: Array, beyond: Array) -> Array:
    """Return whether violations begin or end in steps, or may do so between evaluations; as `changes`."""
    return changes(m, beyond) | (may_cross(m[0], m[1], m[2]) | may_cross(m[-1], m[-2], m[-3])).any(axis=-1)


def _first_zero(curves: MarginCurves, begin: float, acting: Array) -> float | None:
    """Return the first time at which an acting margin is negative; None if there is none.

    A dip before the step's start that is found only in this step counts as one at the start.
    """
    times, margins = curves.table()
    if not len(acting) or not (margins[:, acting] < 0.0).any():
        return None
    rows = (margins[:, acting] < 0.0).any(axis=1)
    k = int(np.argmax(rows))
    if times[k] <= begin:
        return begin
    t, b = float(times[k - 1]), float(times[k])
    below = acting[margins[k, acting] < 0.0].tolist()
    return min(
        crossing(curves.signal(i), t, float(margins[k - 1, i]), b, float(margins[k, i]), CROSSING) for i in below
    )
