"""Margins inside a step: every dip below zero is found, its beginning to 1e-12 s, its depth to rounding.

The margins are known at the step's start. They are looked at after every eighth of the step and at the
scheme's stage times, each point reached by one shorter step from the start, in parts where `SubdividingStepper` asks
for them (never an interpolant).

What is found for certain: *every dip below zero that lasts a quarter of a step*. Looks are at most h/8
apart, from step to step too, so any interval of h/4 holds at least two of them: the dip shows as a
negative margin, whatever its shape. With steps that end where a torque schedule has its knots and turning
points, or at declared breakpoints, a margin within a step is smooth, and *shorter dips* show as a minimum
between the looks:

* Three looks of which the middle one is lowest bracket a minimum. It is refined if it could be negative,
  or lower than any before in the run. The last look of the step before is the left neighbour of the start.
* Where a margin comes down to the step's end, or goes up from its start, steeply enough to have been
  negative in between, the eighth there is looked at in eighths.

Where a smooth stretch begins or ends (at a knot, an event) there is no look beyond, and only the second
rule holds for the outermost eighth. "Could be" means two drops below the lower look, a drop being the rise
to its higher neighbour: for a parabola the minimum is at most 1/8 of a drop below, for two straight lines
at most one drop. A margin is the least of several (conditions of a contact, ends of a range), and a
difference to an absolute value: where another one takes over it has a kink that points up, so minima are
where one of them is smooth. The searches do not rely on it.
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

LOOKS = 8  # a step
DROPS = 2.0
FLAT = 1e-9  # relative, or absolute below 1: a smaller drop is rounding
PLACE = 1e-7  # of a step: precision of where a minimum is
CROSSING = 1e-13  # [s]: precision of a zero

Reach = Callable[[Sequence[float]], list[Advance]]
REFUSALS = (SingularChainError, ClosureError, StateError)


class StepMargins(NamedTuple):
    """What the visuals of a step show.

    Attributes:
        times: (looks,) in order; the first is the last look of the step before, if there is one.
        margins: (looks, signals).
        start: which of the looks is the step's start.
        end: where the step ends: as asked, or where the first acting margin becomes negative.
        acting: the signal that ended it, or None.
    """

    times: Array
    margins: Array
    start: int
    end: Advance
    acting: int | None


@dataclass(frozen=True, eq=False)
class MarginCurves:
    """Margins as a function of time, about an accepted instant; what was looked at is remembered.

    Attributes:
        reach: single steps to given times.
        of: all margins at some instants, (instants, signals).
        margins: by time, as far as looked at.
        advances: by time, those of this step.
    """

    reach: Reach
    of: Callable[[Sequence[Instant]], Array]
    margins: dict[float, Array]
    advances: dict[float, Advance]

    def look(self, times: Sequence[float]) -> HoldfastError | None:
        """Look at several times at once; return why the first of them cannot be reached that cannot."""
        found = self.reach([t for t in times if t not in self.margins])
        failed = next((k for k, reached in enumerate(found) if reached.instant is None), len(found))
        led = found[:failed]
        self.advances.update((reached.t, reached) for reached in led)
        instants = [reached.instant for reached in led if reached.instant is not None]
        if instants:
            self.margins.update(zip((reached.t for reached in led), self.of(instants), strict=True))
        return found[failed].failure if failed < len(found) else None

    def signal(self, i: int) -> Callable[[float], float]:
        """Return one margin as a function of time; it raises what a step there is refused for."""

        def margin(t: float) -> float:
            failure = self.look([t])
            if failure is not None:
                raise failure
            return float(self.margins[t][i])

        return margin

    def table(self) -> tuple[Array, Array]:
        """Return times in order and the margins then, (looks, signals)."""
        times = np.array(sorted(self.margins))
        return times, np.array([self.margins[t] for t in times])


def look_times(begin: float, end: float, nodes: Sequence[float]) -> list[float]:
    """Return the times after `begin` at which a step's margins are looked at; the last is the end.

    Args:
        begin: of the step [s].
        end: of the step [s].
        nodes: the scheme's stage times, parts of a step.
    """
    parts = {k / LOOKS for k in range(1, LOOKS)} | {float(c) for c in nodes if 0.0 < c < 1.0}
    inside = {begin + part * (end - begin) for part in parts}
    return [*sorted(t for t in inside if begin < t < end), end]


def verify(
    curves: MarginCurves, begin: float, times: list[float], watched: Array, acting: Array, lowest: Array
) -> StepMargins:
    """Return the margins of a step, refined, and where it has to end.

    Args:
        curves: with the margins at the step's start, and those of the last look before it if the margins
            are smooth there.
        begin: the step's start [s].
        times: from `look_times`.
        watched: indices of the signals that something limits.
        acting: those of them that end the step where they become negative.
        lowest: (signals,) the lowest margins of the run so far.
    """
    failure = curves.look(times)
    try:
        if failure is None:
            _look_closer(curves, begin, watched)
            _refine_minima(curves, watched, lowest, PLACE * (times[-1] - begin))
        zero = _first_zero(curves, begin, acting)
    except REFUSALS as cause:
        failure, zero = cause, None
    end, signal = times[-1], None
    if zero is not None:
        end, signal = zero
    elif failure is not None:
        curves.advances[end] = Advance(end, None, NO_GAPS, np.zeros(4), failure=failure)
    found, margins = curves.table()
    kept = found <= end
    return StepMargins(found[kept], margins[kept], int(np.searchsorted(found, begin)), curves.advances[end], signal)


def _look_closer(curves: MarginCurves, begin: float, watched: Array) -> None:
    """Look at the eighths of a step's first and last eighth where a margin may be negative in between."""
    times, margins = curves.table()
    first = int(np.searchsorted(times, begin))
    m = margins[first:, watched]
    if len(m) < 3:
        return
    more = []
    for (a, b, c), (s, t) in (((0, 1, 2), (first, first + 1)), ((-1, -2, -3), (-2, -1))):
        drop = m[b] - m[a]
        steepest = np.maximum(drop, m[c] - m[b])
        if ((drop > 0.0) & (m[a] >= 0.0) & (m[a] < DROPS * steepest)).any():
            more += [times[s] + k / LOOKS * (times[t] - times[s]) for k in range(1, LOOKS)]
    failure = curves.look(sorted({float(t) for t in more} - {float(t) for t in times})) if more else None
    if failure is not None:
        raise failure


def _refine_minima(curves: MarginCurves, watched: Array, lowest: Array, precision: float) -> None:
    """Search every bracketed minimum that may be negative, or lower than any before, all of them side by side."""
    times, margins = curves.table()
    m = margins[:, watched]
    drop = np.maximum(m[:-2], m[2:]) - m[1:-1]
    sizes = np.maximum(1.0, np.abs(m[1:-1]))
    bracket = (m[1:-1] <= m[:-2]) & (m[1:-1] <= m[2:]) & (drop > FLAT * sizes)
    least = np.minimum(lowest[watched], m.min(axis=0))
    possible = m[1:-1] - DROPS * drop
    worthwhile = possible < least - FLAT * sizes
    worthwhile |= (m[1:-1] >= 0.0) & (possible < 0.0)
    found = [(times[k : k + 3].tolist(), int(watched[i])) for k, i in np.argwhere(bracket & worthwhile)]

    def margins_at(asked: Mapping[int, float]) -> list[float]:
        failure = curves.look(sorted(set(asked.values())))
        if failure is not None:
            raise failure
        return [float(curves.margins[t][found[k][1]]) for k, t in asked.items()]

    together([search_lowest(a, b, c, precision) for (a, b, c), _ in found], margins_at)


def _first_zero(curves: MarginCurves, begin: float, acting: Array) -> tuple[float, int] | None:
    """Return when the first acting margin becomes negative, and which; it is negative then.

    A dip before the step's start, found only now, counts at the start.
    """
    times, margins = curves.table()
    if not len(acting) or not (margins[:, acting] < 0.0).any():
        return None
    rows = (margins[:, acting] < 0.0).any(axis=1)
    k = int(np.argmax(rows))
    below = [int(i) for i in acting[margins[k, acting] < 0.0]]
    if times[k] <= begin:
        return begin, below[0]
    t, b = float(times[k - 1]), float(times[k])
    zeros = [
        (crossing(curves.signal(i), t, float(margins[k - 1, i]), b, float(margins[k, i]), CROSSING), i) for i in below
    ]
    return min(zeros)
