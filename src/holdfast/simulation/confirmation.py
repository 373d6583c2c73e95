"""A violation is believed only where shorter steps show it too.

A fixed step that is too long for the chain makes velocities grow from step to step, and before anything
overflows, the forces of that growth pass a limit: a grasp seems to slip. So before a slip, a limit or a
singular configuration is reported, the step that shows it is taken again in halves and in quarters, and so
is the step before, which may have brought what grew. In halves a growth of 1.001 a step is a decay to a tenth;
quarters, because of two steps that are both too long one may by chance come out like the other.

A true violation comes out the same but for the scheme's error, a small part of what the margin changes by.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.constraint import coordinate_sizes
from holdfast.errors import HoldfastError, SingularChainError, StepTooLongError
from holdfast.simulation.instant import Instant
from holdfast.simulation.margins import ViolationTracker
from holdfast.simulation.segment import Segment
from holdfast.simulation.stability import (
    Decay,
    fastest_decay,
    feedback_resistance,
    followed,
    passive_resistance,
    step_for,
)
from holdfast.simulation.stepper import Advance, in_parts
from holdfast.simulation.verification import StepMargins

PARTS = (2, 4)
SHARE = 0.05  # of what a margin, or the velocities, change by: steps that differ by more are too long
ROUNDING = 1e-6  # relative, or absolute below 1: a smaller difference is none
MOST_PARTS = 16  # of a step that fails, to see whether shorter ones do too
MOST_TRIED = 200  # steps, to see whether a suggested length works
HALVINGS = 8


class Window:
    """The step that shows something, and the one before it, to be taken again in parts."""

    def __init__(self, segment: Segment, previous: Instant | None, now: Instant) -> None:
        """Take the chain, the instant before (None where `now` begins a smooth stretch) and the step's start."""
        self.segment, self.previous, self.now = segment, previous, now

    @property
    def begin(self) -> Instant:
        """Where the window begins."""
        return self.now if self.previous is None else self.previous

    def in_parts(self, t: float, parts: int) -> Advance:
        """Return where parts of both steps lead, to a time within the window."""
        stepper, begin = self.segment.stepper, self.begin
        if t <= self.now.t or self.previous is None:
            return in_parts(stepper, begin, t, parts)
        first = in_parts(stepper, begin, self.now.t, parts)
        return first if first.instant is None else in_parts(stepper, first.instant, t, parts)


def require_shown(window: Window, found: StepMargins, tracker: ViolationTracker) -> None:
    """Refuse violations that begin in a step and that shorter steps do not show.

    Args:
        window: the step and the one before.
        found: the margins along it.
        tracker: margins before it.

    Raises:
        StepTooLongError: shorter steps disagree.
    """
    if not (found.margins < 0.0).any():
        return
    signals = window.segment.signals
    fresh = np.flatnonzero(np.isinf(tracker.since) & (found.margins.min(axis=0) < 0.0)).tolist()
    for k, together in _by_time(found, fresh):
        t, margins = float(found.times[k]), found.margins[: k + 1, together]
        if t <= window.begin.t:  # nothing leads there: it is so where a stretch begins
            continue
        allowed = SHARE * np.ptp(margins, axis=0) + ROUNDING * np.maximum(1.0, np.abs(margins[-1]))
        for parts in PARTS:
            again = window.in_parts(t, parts)
            if again.instant is not None:
                off = np.abs(signals.of(again.instant)[together] - margins[-1])
                if (off <= allowed).all():
                    continue
                together = [together[int(np.argmax(off / allowed))]]
            names = f"{signals.quantities[together[0]]} margin of '{signals.names[together[0]]}' negative"
            raise too_long(window, t, f"steps of 1/{parts} of it do not find the {names} that it does")


def explained(window: Window, until: float, failure: HoldfastError) -> HoldfastError:
    """Return why a step failed: that it is too long, where shorter ones show so.

    Args:
        window: the step and the one before.
        until: the step's end [s].
        failure: what the step failed with.
    """
    decay = _decay(window)
    if decay is not None and not followed(decay, window.segment.settings.longest_step, window.segment.scheme):
        return too_long(window, until, f"a step fails ({failure})")
    most = PARTS[0] if isinstance(failure, SingularChainError) else MOST_PARTS
    parts, fewer = 2, window.in_parts(until, 2)
    while parts <= most:
        more = window.in_parts(until, 2 * parts)
        if _agree(window.begin, fewer, more):
            return too_long(window, until, f"it fails, and steps of 1/{parts} of it do not ({failure})")
        parts, fewer = 2 * parts, more
    return failure


def too_long(window: Window, until: float, why: str) -> StepTooLongError:
    """Return the error of a step that is too long, with the joint and a step that works.

    The step comes from how fast damping, friction and the controller make velocities decay, or is half of
    the one taken; it is halved until steps of half its length lead to the same.

    Args:
        window: the steps that show it.
        until: the time to which they do [s].
        why: what gives it away.
    """
    scheme, decay = window.segment.scheme, _decay(window)
    step = window.segment.settings.longest_step
    if decay is not None and not followed(decay, step, scheme):
        joint, reason = decay.joint, f"slowed down at {decay.rate:.3g} 1/s by damping, friction or its controller"
        limit = step_for(decay, scheme)
    else:
        joint, reason, limit = _most_different(window, until), "which moves otherwise then", 0.5 * step
    fitting = _working(window, until, limit)
    advice = f"a step of {fitting:g} s" if np.isfinite(fitting) else "a much smaller step"
    if (hold := window.segment.settings.hold) is not None:
        advice += (
            f"; where that fails too, lower gains: they may be too high for a sample time of {hold.sample_time:g} s"
        )
    return StepTooLongError(
        f"the step of {step:g} s is too long for joint '{joint}', {reason}: {why}; try {advice}", joint, fitting
    )


def _by_time(found: StepMargins, signals: Sequence[int]) -> Iterator[tuple[int, list[int]]]:
    """Yield looks and the signals that are lowest there."""
    lowest = {i: int(np.argmin(found.margins[:, i])) for i in signals}
    for k in sorted(set(lowest.values())):
        yield k, [i for i in signals if lowest[i] == k]


def _decay(window: Window) -> Decay | None:
    """Return the fastest decay where a window begins, feedback included; None where it cannot be found.

    Linearly implicit steps have to follow the controller's feedback only.
    """
    at, controller = window.begin, window.segment.controller
    try:
        resistance = feedback_resistance(controller, at)
        if not window.segment.scheme.implicit:
            resistance = resistance + passive_resistance(at.chain, at.state.qd)
        return fastest_decay(at.chain, at.state, resistance)
    except (HoldfastError, np.linalg.LinAlgError):
        return None


def _working(window: Window, until: float, step: float) -> float:
    """Return the longest of a step and its halves that leads where steps of half its length do; not a number if none.

    Tried on the window, or its beginning where that would be many steps.
    """
    stepper, begin = window.segment.stepper, window.begin
    for tried in step * 0.5 ** np.arange(HALVINGS):
        count = min(math.ceil((until - begin.t) / tried), MOST_TRIED)
        end = min(begin.t + count * tried, until)
        if _agree(begin, *(in_parts(stepper, begin, end, parts) for parts in (count, 2 * count))):
            return float(f"{tried:.2g}")
    return math.nan


def _most_different(window: Window, until: float) -> str:
    """Return the joint that steps and halves of them move most differently."""
    whole, halves = (window.in_parts(until, parts).instant for parts in (1, 2))
    now = window.now
    rates = now.state.qd if whole is None or halves is None else whole.state.qd - halves.state.qd
    motion = chain_motion(now.chain, now.state, now.tau, now.inputs.shaped(now.chain))
    return now.chain.joint_names()[int(np.argmax(np.abs(rates) / coordinate_sizes(motion)[: len(rates)]))]


def _agree(begin: Instant, one: Advance, other: Advance) -> bool:
    """Return whether two ways from an instant end at about the same velocities."""
    if one.instant is None or other.instant is None:
        return False
    v, w = one.instant.velocities, other.instant.velocities
    change = np.abs(w - begin.velocities).max()
    return bool(np.abs(v - w).max() <= SHARE * change + ROUNDING * max(1.0, np.abs(w).max()))
