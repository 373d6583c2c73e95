"""Margins over a run: the lowest so far, and which are violated since when."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from holdfast.simulation.bracket import crossing
from holdfast.simulation.instant import Instant
from holdfast.simulation.limits import Signals
from holdfast.simulation.occurrence import Occurrence
from holdfast.simulation.verification import CROSSING, Course, Found
from holdfast.spatial.scalar import Array

Words = Callable[[float, int], str]


@dataclass(frozen=True, eq=False)
class Ledger:
    """Margins over a run so far; in every array the signals of `limits.Signals`.

    Attributes:
        lowest: the lowest margin so far; infinite where nothing limits.
        since: when the present violation began [s]; infinite where there is none.
        depth: the lowest margin of the present violation; infinite where there is none.
        depth_time: when that was [s].
    """

    lowest: Array
    since: Array
    depth: Array
    depth_time: Array

    @classmethod
    def blank(cls, signals: int) -> Self:
        """Return the ledger of a run that has not begun."""
        return cls(*(np.full(signals, np.inf) for _ in range(4)))

    def at(self, t: float, margins: Array, signals: Signals, now: Instant) -> tuple[Self, list[Occurrence]]:
        """Return the ledger after an instant that no step led to, and what it tells.

        Args:
            t: time [s].
            margins: (signals,) then.
            signals: of the chain then.
            now: the instant, for words.
        """
        here = np.array([t]), margins[None]
        return self._entered([(i, *here) for i in signals.limited], signals, lambda _, i: signals.words(now, i))

    def after(self, found: Found, course: Course, signals: Signals) -> tuple[Self, list[Occurrence]]:
        """Return the ledger after a step, and what happened in it, zeros refined."""
        if not (found.margins < 0.0).any() and np.isinf(self.since).all():
            return replace(self, lowest=np.minimum(self.lowest, found.margins.min(axis=0))), []
        entries = []
        for i in signals.limited:
            entries.append((i, *self._with_zeros(int(i), found, course)))
        return self._entered(entries, signals, lambda t, i: _words(course, signals, t, i))

    def without(self, signal: int) -> Self:
        """Return the ledger when nothing limits a signal any more."""
        kept = {name: getattr(self, name).copy() for name in ("since", "depth", "depth_time")}
        for array in kept.values():
            array[signal] = np.inf
        return replace(self, **kept)

    def _with_zeros(self, i: int, found: Found, course: Course) -> tuple[Array, Array]:
        """Return times and margins of a signal through a step, changes of sign narrowed down."""
        m = found.margins[:, i]
        # what lies before the start is of the last step, unless a dip shows there only now
        first = found.start if (m[0] < 0.0) != (m[found.start] < 0.0) else 0
        times, m = found.times[first:], m[first:]
        for k in np.flatnonzero(np.diff(m < 0.0)):
            ends = float(times[k]), float(m[k]), float(times[k + 1]), float(m[k + 1])
            crossing(course.signal(i), *ends, CROSSING)
        looked, margins = course.table()
        inside = (looked >= times[0]) & (looked <= times[-1])
        return looked[inside], margins[inside]

    def _entered(
        self, entries: list[tuple[int, Array, Array]], signals: Signals, words: Words
    ) -> tuple[Self, list[Occurrence]]:
        """Return the ledger after signals were followed through times and margins."""
        lowest, since, depth, when = (getattr(self, f).copy() for f in ("lowest", "since", "depth", "depth_time"))
        happened = []
        for i, times, margins in entries:
            name, quantity = signals.names[i], signals.quantities[i]
            for t, m in zip(times.tolist(), margins[:, i].tolist(), strict=True):
                lowest[i] = min(lowest[i], m)
                if m < 0.0 and np.isinf(since[i]):
                    since[i] = t
                    happened.append(Occurrence(t, "violation", name, words(t, i), quantity))
                elif m >= 0.0 and np.isfinite(since[i]):
                    past = f"within limits again after {t - since[i]:.3g} s, at worst {depth[i]:.4g}"
                    lowest_at = float(depth[i]), float(when[i])
                    happened.append(Occurrence(t, "recovery", name, past, quantity, *lowest_at))
                    since[i] = depth[i] = when[i] = np.inf
                if m < min(depth[i], 0.0):
                    depth[i], when[i] = m, t
        happened.sort(key=lambda one: one.t)
        return replace(self, lowest=lowest, since=since, depth=depth, depth_time=when), happened


def _words(course: Course, signals: Signals, t: float, i: int) -> str:
    reached = course.advances.get(t)
    if reached is None or reached.instant is None:  # in the step before
        return f"{signals.quantities[i]} margin of '{signals.names[i]}' is negative"
    return signals.words(reached.instant, i)
