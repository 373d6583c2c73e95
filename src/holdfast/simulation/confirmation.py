"""Confirmation of violations: one is reported only if shorter steps show it, too.

With a fixed step that is too long for the chain, velocities grow from step to step. Before anything overflows, the
forces of this numerical growth exceed a limit, and a grasp seems to slip. Before a slip, a violated limit or a singular
configuration is reported, the step that shows it is therefore repeated in halves and in quarters, together with the
step before it, in which the growth may have begun. A mode that grows by a factor of 1.001 per step decays to about a
tenth when the step is halved. Quarters are needed because two steps that are both too long can agree by chance. A true
violation is found again, up to the error of the scheme, which is a small part of the change of the margin. Where a
margin jumps, as the force of a contact that comes from a face to a round edge, it is found a little later at most.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.constraint import coordinate_sizes
from holdfast.errors import ClosureError, HoldfastError, SingularChainError, StepTooLongError
from holdfast.model.force_element import HELD_OBJECT
from holdfast.simulation.instant import Instant
from holdfast.simulation.linearly_implicit import passive_terms
from holdfast.simulation.margins import ViolationTracker, freedom_names
from holdfast.simulation.resolution import MOST_UNRESOLVED, Resolution, largest_of, leap, least_difference
from holdfast.simulation.segment import Segment
from holdfast.simulation.stability import (
    Decay,
    fastest_decay,
    fastest_swing,
    feedback,
    feedback_resistance,
    feedback_stiffness,
    followed,
    moved,
    of_joints,
    quicker,
    step_for,
)
from holdfast.simulation.stepper import Advance, in_parts
from holdfast.simulation.verification import StepMargins
from holdfast.spatial.scalar import Array

SHORTER_BY = (2, 4)
SHARE = 0.05  # steps are too long if their results differ by more than this part of the change of margin or velocities
JUMPS_LATER = 1e-3  # of the time since the window's begin: so much later a margin may jump in shorter steps
NEGLIGIBLE_DIFFERENCE = 1e-6  # smaller differences (relative, or absolute below 1) are ignored
MOST_REPEATED_PARTS = 16  # largest number of parts in which a failed step is repeated
MOST_STEPS_TRIED = 200  # largest number of steps for which a suggested length is tried
MOST_IN_CONTACT = 200  # steps in all for that, while contacts press: such a step takes tens of milliseconds
SUGGESTED_HALVINGS = 8
OWN_GAIN = 0.01  # smallest feedback of a joint's own motion that is named, relative to that of any motion


class Window:
    """The step that shows a violation and the step before it, which are repeated in parts."""

    def __init__(self, segment: Segment, previous: Instant | None, now: Instant) -> None:
        """Store the segment, the previous instant (None if `now` begins a smooth stretch) and the step's start."""
        self.segment, self.previous, self.now = segment, previous, now

    @property
    def begin(self) -> Instant:
        """The instant at which the window begins."""
        return self.now if self.previous is None else self.previous

    def in_parts(self, t: float, parts: int) -> Advance:
        """Return the result at a time within the window when both steps are taken in parts."""
        stepper, begin = self.segment.stepper, self.begin
        if t <= self.now.t or self.previous is None:
            return in_parts(stepper, begin, t, parts)
        first = in_parts(stepper, begin, self.now.t, parts)
        return first if first.instant is None else in_parts(stepper, first.instant, t, parts)


def require_shown(window: Window, found: StepMargins, tracker: ViolationTracker) -> None:
    """Raise an error if a violation begins in a step and shorter steps do not show it.

    Violations that are only recorded end a run only if a damper, a spring or the controller is too fast for the step.

    Args:
        window: the step and the one before it.
        found: the margins during the step.
        tracker: the margins before the step.

    Raises:
        StepTooLongError: shorter steps give different margins.
    """
    if not (found.margins < 0.0).any():
        return
    signals, acting = window.segment.signals, window.segment.acting
    fresh = np.flatnonzero(np.isinf(tracker.since) & (found.margins.min(axis=0) < 0.0)).tolist()
    for k, together in _by_time(found, fresh):
        t, depth = float(found.times[k]), found.margins[k, together]
        if t <= window.begin.t:  # no step leads to the beginning of a stretch, so there is nothing to repeat
            continue
        change = np.ptp(found.margins[:, together], axis=0)
        allowed = SHARE * change + NEGLIGIBLE_DIFFERENCE * np.maximum(1.0, np.abs(depth))
        for parts in SHORTER_BY:
            off = _difference(window, t, parts, together, depth)
            if not (off <= allowed).all():
                later = t + JUMPS_LATER * (t - window.begin.t)
                off = np.minimum(off, _difference(window, later, parts, together, depth))
            if (off <= allowed).all():
                continue
            if _cause(window) is None:  # then only what acts on the run is worth its end
                off = np.where(np.isin(together, acting), off, 0.0)
            if not (off <= allowed).all():
                worst = together[int(np.argmax(off / allowed))]
                margin = f"{signals.quantities[worst]} margin of '{signals.names[worst]}'"
                raise too_long(window, t, f"the full step finds a negative {margin}, {parts} shorter steps do not")


def _difference(window: Window, t: float, parts: int, signals: Sequence[int], depth: Array) -> Array:
    """Return how much signals differ from (signals,) values at a time when both steps are taken in parts."""
    again = window.in_parts(t, parts).instant
    return np.full(len(depth), np.inf) if again is None else np.abs(window.segment.signals.of(again)[signals] - depth)


def resolved(found: Resolution, window: Window, later: Instant) -> Resolution:
    """Return whether steps have followed the motion, after a step of fixed length from `window.now` to a later instant.

    A step that may not follow it (`simulation.resolution`) is repeated in halves, and is unresolved if their velocities
    differ from its own by more than 1 % of the largest so far. This is reported at the run's end, unless it was small
    against the motion that followed. If many steps in a row are unresolved and a damper, a spring or the controller is
    the cause, the run ends.

    Args:
        found: what is known before the step.
        window: the step and the one before it.
        later: the step's end.

    Raises:
        StepTooLongError: many steps in a row were unresolved, because velocities decay too fast for them.
    """
    now, scheme = window.now, window.segment.scheme
    v0, v1, a0, a1 = now.velocities, later.velocities, now.accelerations, later.accelerations
    largest = float(max(found.largest, largest_of(v0), largest_of(v1)))
    least = least_difference(largest)
    found = found._replace(largest=largest)
    if not (jump := float(leap(later.t - now.t, v0, v1, a0, a1))) > least:
        return found._replace(in_a_row=0)
    in_a_row = found.in_a_row + 1
    if jump <= 2.0 * found.seen and in_a_row % MOST_UNRESOLVED:
        return found._replace(in_a_row=in_a_row)
    found = found._replace(seen=max(found.seen, jump))
    halves = in_parts(window.segment.stepper, now, later.t, 2).instant
    difference = math.inf if halves is None else float(np.abs(halves.velocities - v1).max())
    if difference <= least:
        return found._replace(in_a_row=0)
    why = f"halves of the step to t = {later.t:.6g} s give velocities that differ by {difference:.3g} rad/s or m/s"
    if in_a_row % MOST_UNRESOLVED == 0 and _cause(window) is not None:
        raise too_long(window, later.t, f"{why}, and {in_a_row - 1} steps before it were unresolved, too")
    if difference <= found.off or scheme.implicit:  # implicit steps damp transients
        return found._replace(in_a_row=in_a_row)
    text = f"{too_long(window, later.t, why)}; if torques or wrenches jump there, name the time in `breakpoints`"
    return found._replace(in_a_row=in_a_row, off=difference, text=text)


def explained(window: Window, until: float, failure: HoldfastError) -> HoldfastError:
    """Return the error to report for a failed step: that it is too long if shorter steps succeed, else its own.

    Args:
        window: the step and the one before it.
        until: the step's end [s].
        failure: the error that the step raised.
    """
    if _cause(window) is not None:
        return too_long(window, until, f"a step fails ({failure})")
    most = SHORTER_BY[0] if isinstance(failure, SingularChainError) else MOST_REPEATED_PARTS
    parts, fewer = 2, window.in_parts(until, 2)
    while parts <= most:
        more = window.in_parts(until, 2 * parts)
        if _agree(window.begin, fewer, more):
            return too_long(window, until, f"the full step fails, {parts} shorter steps do not ({failure})")
        parts, fewer = 2 * parts, more
    sampled = window.segment.settings.hold is not None
    return (
        ClosureError(_or_lower_gains(window, str(failure)))
        if sampled and isinstance(failure, ClosureError)
        else failure
    )


def too_long(window: Window, until: float, why: str) -> StepTooLongError:
    """Return the error for a step that is too long, which names the joint, the cause if known, and a step that works.

    The suggested step follows from the rate at which velocities decay or joints swing, if that is the cause;
    otherwise it is half the step taken. It is halved until steps of half its length give the same result.

    Args:
        window: the steps that were found too long.
        until: the end of the comparison [s].
        why: how it was noticed, for the message.
    """
    step = window.segment.settings.longest_step
    if (cause := _cause(window)) is not None:
        joint, reason, limit = cause.decay.joint, cause.words, step_for(cause.decay, window.segment.scheme)
    else:
        joint, reason = _most_different(window, until), "whose motion changes when the step is halved"
        limit = 0.5 * step
    fitting = _working(window, until, limit)
    advice = f"a step of {fitting:g} s" if np.isfinite(fitting) else "a much smaller step"
    advice = _or_lower_gains(window, advice)
    return StepTooLongError(
        f"the step of {step:g} s is too long for joint '{joint}', {reason}: {why}; try {advice}", joint, fitting
    )


def _or_lower_gains(window: Window, advice: str) -> str:
    """Return advice for a step that fails, with what may be the cause if the controller is sampled."""
    hold = window.segment.settings.hold
    if hold is None:
        return advice
    return (
        f"{advice}; where that fails too, lower gains: they may be too high for a sample time of {hold.sample_time:g} s"
    )


def _by_time(found: StepMargins, signals: Sequence[int]) -> Iterator[tuple[int, list[int]]]:
    """Yield, in order of time, the index of a time and the signals that are lowest at that time."""
    lowest = {i: int(np.argmin(found.margins[:, i])) for i in signals}
    for k in sorted(set(lowest.values())):
        yield k, [i for i in signals if lowest[i] == k]


class Cause(NamedTuple):
    """Why velocities change too fast for a step: how fast, and in which joint, and in words by what."""

    decay: Decay
    words: str


def _cause(window: Window) -> Cause | None:
    """Return the damper, spring or gain that is too fast for the step at the start of a window, as far as it is known.

    With linearly implicit steps only the feedback of the controller counts. It is not known for a chain that is
    answered as a forest.
    """
    if window.begin.chain.beyond_serial:
        return None
    at, scheme, controller = window.begin, window.segment.scheme, window.segment.controller
    if not at.chain.joint_count:
        return None
    chain, state, passive = at.chain, at.state, passive_terms(at.chain)
    own, step = 0.0 if scheme.implicit else 1.0, window.segment.settings.longest_step
    sizes = [own * passive.resistance(state.qd), own * passive.stiffness]  # of dampers and of springs
    try:
        passively = [of_joints(chain, one) for one in sizes]
        wholly = [passively[0] + feedback_resistance(controller, at), passively[1] + feedback_stiffness(controller, at)]
        alone, found = (
            [fastest_decay(chain, state, one[0]), fastest_swing(chain, state, one[1])] for one in (passively, wholly)
        )
        swings = found[1].rate > found[0].rate
        decay, i = found[swings], chain.joint_names().index(found[swings].joint)
        of_joint = np.eye(chain.velocity_count)[:, [i]]
        gain = float(feedback(controller, at, of_joint, moved if swings else quicker)[i, 0])
        gain = gain if gain > OWN_GAIN * np.abs(wholly[swings][i]).max() else 0.0
    except (HoldfastError, np.linalg.LinAlgError):
        return None
    if followed(decay, step, scheme):
        return None
    turns, size = chain.all_joints[i].turns, float(sizes[swings][i])
    unit = ("N m/rad" if turns else "N/m") if swings else ("N m s/rad" if turns else "N s/m")
    by = "spring" if swings else "damping" if passive.damping[i] > 0.5 * size else "friction"
    if followed(alone[swings], step, scheme):  # its gain is zero if it feeds back the object's motion
        by, size = "controller" + "'s gain" * (gain > 0.0), gain
    how = f"swinging at {decay.rate:.3g} rad/s" if swings else f"slowed down at {decay.rate:.3g} 1/s"
    return Cause(decay, f"{how} by its {by}" + f" of {size:.3g} {unit}" * (size > 0.0))


def _working(window: Window, until: float, step: float) -> float:
    """Return the longest step, of a step and its repeated halves, that agrees with half steps; NaN if there is none.

    The steps are tried on the whole window, or on its beginning if the window would take too many of them.
    While contacts press, fewer lengths are tried.
    """
    stepper, begin = window.segment.stepper, window.begin
    left = math.inf if window.segment.contacts is None else MOST_IN_CONTACT
    for tried in step * 0.5 ** np.arange(SUGGESTED_HALVINGS):
        count = min(math.ceil((until - begin.t) / tried), MOST_STEPS_TRIED)
        if (left := left - 3 * count) < 0:
            break
        end = min(begin.t + count * tried, until)
        if _agree(begin, *(in_parts(stepper, begin, end, parts) for parts in (count, 2 * count))):
            return float(f"{tried:.2g}")
    return math.nan


def _most_different(window: Window, until: float) -> str:
    """Return the joint whose motion differs most between whole steps and half steps."""
    if not window.now.chain.joint_count:
        return HELD_OBJECT
    whole, halves = (window.in_parts(until, parts).instant for parts in (1, 2))
    now = window.now
    rates = now.state.qd if whole is None or halves is None else whole.state.qd - halves.state.qd
    if now.chain.beyond_serial:
        return freedom_names(now.chain)[int(np.argmax(np.abs(rates)))]
    motion = chain_motion(now.chain, now.state, now.tau, now.inputs.shaped(now.chain))
    return now.chain.joint_names()[int(np.argmax(np.abs(rates) / coordinate_sizes(motion)[: len(rates)]))]


def _agree(begin: Instant, one: Advance, other: Advance) -> bool:
    """Return whether two sequences of steps from one instant end with about the same velocities."""
    if one.instant is None or other.instant is None:
        return False
    v, w = one.instant.velocities, other.instant.velocities
    change = np.abs(w - begin.velocities).max()
    return bool(np.abs(v - w).max() <= SHARE * change + NEGLIGIBLE_DIFFERENCE * max(1.0, np.abs(w).max()))
