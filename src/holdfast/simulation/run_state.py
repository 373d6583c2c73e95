"""Where a run is, and what comes next: a step, a jump, a grasp that opens, the end."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from holdfast.errors import HoldfastError, StateError
from holdfast.simulation.adaptive import first_proposal, next_step
from holdfast.simulation.adaptive_parts import halves_agree
from holdfast.simulation.balance import Sums
from holdfast.simulation.checkpoint import Checkpoint, Origin
from holdfast.simulation.confirmation import Window, explained, require_shown, too_long
from holdfast.simulation.events import Attach, happen
from holdfast.simulation.instant import Instant
from holdfast.simulation.margins import ViolationTracker
from holdfast.simulation.segment import RunSettings, Segment, first_segment, resumed_segment, segment_with
from holdfast.simulation.singular_posture import (
    CLOSED,
    SingularPosture,
    length_before,
    length_through,
    may_be_unresolved,
    may_lose_rank,
    posture_ahead,
    postures_passed,
    time_left,
)
from holdfast.simulation.stability import elsewhere, require_followed
from holdfast.simulation.step import Gaps
from holdfast.simulation.stepper import NO_GAPS, Advance, Stepper
from holdfast.simulation.stops import just_after
from holdfast.simulation.trajectory import Occurrence
from holdfast.simulation.verification import MarginCurves, StepMargins, look_times, verify
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import shift_wrench
from holdfast.state import State

FASTEST = 1e30  # rad/s or m/s: what is faster ends in numbers that are none


@dataclass(frozen=True, eq=False)
class RunState:
    """A run at one accepted instant.

    Attributes:
        segment: the chain and what moves it.
        checkpoint: what the run can go on from.
        now: the instant, `checkpoint.now` evaluated.
        previous: the instant before, `checkpoint.previous` evaluated; None where now begins a smooth stretch.
        gaps: what projection found and left.
        times: (looks,) at which margins were looked at since the instant before [s].
        margins: (looks, signals) then; the last are those of now.
        ended: why the run ends here, if it does.
    """

    segment: Segment
    checkpoint: Checkpoint
    now: Instant
    previous: Instant | None
    gaps: Gaps
    times: Array
    margins: Array
    ended: str | None = None

    def violated(self) -> int | None:
        """Return the signal most below zero, of those that a run does not go on with."""
        acting, now = self.segment.acting, self.margins[-1]
        if not len(acting) or now[acting].min() >= 0.0:
            return None
        return int(acting[np.argmin(now[acting])])


def start_of_run(settings: RunSettings, state: State) -> RunState:
    """Return the beginning of a run.

    Raises:
        StateError: the state breaks a grasp, or the controller's torques do not fit.
        StepTooLongError: no explicit step of this length can follow the joints' damping.
        SingularChainError: the configuration is singular.
    """
    segment = first_segment(settings, Origin(0.0, state, None))
    require_followed(settings.environment.at(0.0)[0], state, settings.longest_step, settings.scheme)
    now, gaps = segment.stepper.start(0.0, state, None)
    blank = Checkpoint(
        now=Origin(0.0, now.state, None),
        previous=None,
        tail_time=0.0,
        tail=np.zeros(0),
        stop=0,
        event=0,
        grasps=segment.environment.chain.grasps,
        generic_rank=segment.generic_rank,
        sums=Sums(np.zeros(4), 0.0, np.zeros(6)),
        occurrences=(),
        proposal=None,
        tracker=ViolationTracker.blank(len(segment.signals)),
    )
    return _stretch_begins(segment, blank, now, gaps)


def resumed_run(settings: RunSettings, at: Checkpoint) -> RunState:
    """Return a run at a checkpoint."""
    segment = resumed_segment(settings, at.grasps, at.generic_rank)
    now = segment.at(at.now)
    previous = None if at.previous is None else segment.at(at.previous)
    return RunState(segment, at, now, previous, NO_GAPS, np.array([now.t]), segment.margins(now)[None])


def next_state(at: RunState) -> RunState | str | None:
    """Return the run one instant later; the reason why it must stop; or None at its end.

    Raises:
        HoldfastError: the chain cannot go on.
    """
    settings, signals, saved = at.segment.settings, at.segment.signals, at.checkpoint
    if at.ended is not None:
        return at.ended
    signal = at.violated()
    if signal is not None:
        if signals.quantities[signal] == "grasp" and settings.policy.on_slip == "release":
            return _opened(at, signal)
        reached = [one for one in saved.occurrences if one.name == signals.names[signal] and one.kind == "violation"]
        return f"{reached[-1].text} at t = {reached[-1].t:.12g} s"
    times, jumps = settings.stops
    stop = saved.stop
    while stop < len(times) and times[stop] <= at.now.t and not jumps[stop]:
        stop += 1
    if stop == len(times):
        return None
    at = replace(at, checkpoint=replace(saved, stop=stop))
    return _jumped(at) if jumps[stop] else _stepped(at)


def _stepped(at: RunState) -> RunState:
    """Return the run after a step, or at its end where it may not go through a singular posture on the way."""
    segment, now, settings = at.segment, at.now, at.segment.settings
    until = float(settings.stops.times[at.checkpoint.stop])
    goes_on = settings.policy.on_singular == "continue"
    proposal = at.checkpoint.proposal
    step = settings.longest_step if proposal is None else proposal.step
    left = time_left(segment, now, step) if goes_on else None
    if left is not None and (proposal is not None or left <= 1.5 * step):  # no step is to end beside it
        return _towards(at, left, step)
    later, posture = _step_and_posture(at, until)
    if posture is None:
        assert later is not None
        return later
    if goes_on and posture.unique:
        return _towards(at, posture.t - now.t, step)
    return _ended(at, posture)


def _step_and_posture(at: RunState, until: float) -> tuple[RunState | None, SingularPosture | None]:
    """Return the run after a step, if there is one, and the first singular posture on its way.

    A fixed step near a singular posture that is too long for the motion there is taken in parts.
    """
    segment, now = at.segment, at.now
    later, failure = None, None
    try:
        later = _step_to(at, until)
        posture = _first_posture(segment, now, later.now)
    except HoldfastError as cause:
        failure, posture = cause, posture_ahead(segment, now, until)
    leaps = posture is not None and posture.gap > CLOSED
    if (posture is None or leaps) and not segment.settings.scheme.adaptive and _unresolved(at, until, later, leaps):
        try:
            later = _step_to(at, until, stepper=segment.adaptive_parts)
        except HoldfastError as cause:
            failure = failure or cause
        else:
            return later, _first_posture(segment, now, later.now)
    if failure is not None and posture is None:
        raise failure
    return later, posture


def _first_posture(segment: Segment, now: Instant, later: Instant) -> SingularPosture | None:
    """Return the first singular posture between two instants."""
    return next(iter(postures_passed(segment, now, later)), None)


def _unresolved(at: RunState, until: float, later: RunState | None, leaps: bool) -> bool:
    """Return whether a fixed step is too long for the motion near a singular posture.

    Args:
        at: the run.
        until: the step's end [s].
        later: the run then; None if the step fails.
        leaps: whether it leads from one branch of the motion to another.
    """
    if later is None:
        return may_lose_rank(at.now, until)
    if not may_be_unresolved(at.previous, at.now, later.now):
        return False
    return leaps or not halves_agree(at.segment.stepper, at.now, later.now)


def _towards(at: RunState, left: float, step: float) -> RunState:
    """Return the run after a step to a place beside a singular posture, or through it.

    Args:
        at: the run.
        left: how long it takes to get to the posture [s].
        step: a step as long as it may be [s].
    """
    now, segment = at.now, at.segment
    if length_before(left, step) is not None:
        if at.checkpoint.proposal is None:
            return _step_to(at, now.t + left - 0.5 * step)
        return _step_to(at, _latest(at), lambda tried: length_before(left, tried) or tried)
    until = min(now.t + length_through(left, step), _latest(at))
    later = _step_to(at, until, stepper=segment.collocation)
    passed = postures_passed(segment, now, later.now)  # none where the motion turned before it
    branching = [posture for posture in passed if not posture.unique]
    return _ended(at, branching[0]) if branching else _passed(at, later, passed)


def _latest(at: RunState) -> float:
    """Return the time that no step may go beyond: of the next jump, or the run's end [s]."""
    times, jumps = at.segment.settings.stops
    jumping = np.flatnonzero(jumps[at.checkpoint.stop :])
    return float(times[at.checkpoint.stop + jumping[0] - 1] if len(jumping) else times[-1])


def _passed(at: RunState, later: RunState, postures: Sequence[SingularPosture]) -> RunState:
    """Return the run after a step through singular postures."""
    before, after = (one.checkpoint.occurrences for one in (at, later))
    crossed = [posture.occurrence("passes a singular posture") for posture in postures]
    news = sorted([*after[len(before) :], *crossed], key=lambda one: one.t)
    return replace(later, checkpoint=replace(later.checkpoint, occurrences=(*before, *news)))


def _ended(at: RunState, posture: SingularPosture) -> RunState:
    """Return the run as it ends before a singular posture."""
    occurrence = posture.occurrence("stops before a singular posture")
    saved = replace(at.checkpoint, occurrences=(*at.checkpoint.occurrences, occurrence))
    where = f"stopped after t = {at.now.t:.6g} s, before a singular posture at t = {posture.t:.9g} s"
    return replace(at, checkpoint=saved, ended=f"{where}: {posture.text}{_branches(at, posture)}")


def _branches(at: RunState, posture: SingularPosture) -> str:
    """Return why a run that may go on through singular postures does not."""
    if posture.unique or at.segment.settings.policy.on_singular == "stop":
        return ""
    if posture.gap > CLOSED:
        return f". The grasps would be open by {posture.gap:.3g} (m or rad) there: try smaller steps"
    return ". The constraint has its rank again on the same side: more than one motion leads on from there"


def _step_to(
    at: RunState, until: float, placed: Callable[[float], float] | None = None, stepper: Stepper | None = None
) -> RunState:
    """Return the run after a step, to a time or to where a margin becomes negative that acts.

    Args:
        at: the run.
        until: the step's end, or of an adaptive scheme a time not to be stepped over [s].
        placed: lengths of adaptive steps, as for `next_step`.
        stepper: takes the step in the place of the scheme's.
    """
    segment, now, saved = at.segment, at.now, at.checkpoint
    settings, signals = segment.settings, segment.signals
    next_stop = float(settings.stops.times[saved.stop])
    proposal, curves = saved.proposal, _margin_curves(at, stepper or segment.stepper)
    if proposal is not None and stepper is None:
        reached, proposal = next_step(segment.stepper, now, proposal, until, placed)
        assert reached.instant is not None
        curves.advances[reached.t] = reached
        curves.margins[reached.t] = segment.margins(reached.instant)
        until = reached.t
    times = look_times(now.t, until, settings.scheme.c.tolist()) if len(signals.limited) else [until]
    found = verify(curves, now.t, times, signals.limited, segment.acting, saved.tracker.lowest)
    end = found.end
    _require_step(at, found, until)
    assert end.instant is not None
    tracker, news = saved.tracker.after(found, curves, signals)
    margins = found.margins[min(found.start, 1) :]  # the look before belongs to the instant before
    if end.t == now.t:  # a dip just before, found only now
        margins = margins.min(axis=0, keepdims=True)
    tail_time = times[-2] if len(times) > 1 else now.t
    checkpoint = replace(
        saved,
        now=Origin(end.t, end.instant.state, now.memory),
        previous=saved.now,
        tail_time=tail_time,
        tail=curves.margins[tail_time if tail_time in curves.margins else now.t],
        stop=saved.stop + int(end.t == next_stop),
        sums=saved.sums._replace(work=saved.sums.work + end.work),
        proposal=proposal,
        tracker=tracker,
        occurrences=(*saved.occurrences, *news),
    )
    return RunState(segment, checkpoint, end.instant, now, end.gaps, found.times[-len(margins) :], margins)


def _require_step(at: RunState, found: StepMargins, until: float) -> None:
    """Refuse a step that failed, and one of fixed length that the motion is too fast for.

    Raises:
        StepTooLongError: shorter steps do not show what it shows, or could not follow either.
        HoldfastError: why no step leads on.
    """
    settings, end = at.segment.settings, found.end
    window = Window(at.segment, at.previous, at.now)
    if end.instant is None:
        assert end.failure is not None
        raise end.failure if settings.scheme.adaptive else explained(window, until, end.failure)
    state = end.instant.state
    if not np.abs(state.qd).max() < FASTEST:
        why = f"the motion diverges, a joint rate passes {FASTEST:g}"
        raise StateError(why) if settings.scheme.adaptive else too_long(window, until, why)
    if settings.scheme.adaptive:
        return
    require_shown(window, found, at.checkpoint.tracker)
    if elsewhere(at.now.state, state):
        require_followed(end.instant.chain, state, settings.longest_step, settings.scheme)


def _margin_curves(at: RunState, stepper: Stepper) -> MarginCurves:
    """Return the margins about now, so far as they are known; what a stepper leads to comes next."""
    now = at.now

    def reach(times: Sequence[float]) -> list[Advance]:
        before = [t for t in times if t < now.t]
        after = [t for t in times if t >= now.t]
        found = []
        if before:
            assert at.previous is not None
            found += at.segment.stepper.advance(at.previous, before)
        return found + (stepper.advance(now, after) if after else [])

    known = {now.t: at.margins[-1]}
    if at.previous is not None:
        known[at.checkpoint.tail_time] = at.checkpoint.tail
    here = Advance(now.t, now, at.gaps, np.zeros(4))
    return MarginCurves(reach, at.segment.margins, known, {now.t: here})


def _jumped(at: RunState) -> RunState:
    """Return the run on the other side of a breakpoint, after the events of that time."""
    segment, saved = at.segment, at.checkpoint
    settings, before = segment.settings, segment.environment.chain
    t = float(settings.stops.times[saved.stop])
    t = t if t > at.now.t else just_after(at.now.t)  # where a grasp has opened just there
    chain, inputs = segment.environment.at(t)
    state, sums, tracker = at.now.state, saved.sums, saved.tracker
    happening = [event for event in settings.events[saved.event :] if event.t <= t]
    news = []
    for event in happening:
        chain, state, one = happen(event, chain, state, inputs)
        base_impulse = sums.base_impulse
        for arm, impulse in zip(chain.arms.values(), one.base_impulses, strict=False):
            base_impulse = base_impulse + shift_wrench(arm.base.p, np.array(impulse))
        sums = sums._replace(impact=sums.impact + one.energy_change, base_impulse=base_impulse)
        news.append(one)
    origin, gaps = Origin(t, state, at.now.memory), NO_GAPS
    if happening:
        segment = segment_with(segment, chain.grasps, origin)
        require_followed(chain, state, settings.longest_step, settings.scheme)
    if any(isinstance(event, Attach) for event in happening):
        now, gaps = segment.stepper.start(t, state, origin.memory)
        origin = replace(origin, state=now.state)
    else:
        now = segment.at(origin)
    for name in set(before.grasps) - set(chain.grasps):
        tracker = tracker.without(chain.names.index(name))
    known = {"stop": saved.stop + 1, "event": saved.event + len(happening), "sums": sums, "tracker": tracker}
    return _stretch_begins(segment, replace(saved, now=origin, **known), now, gaps, news)


def _opened(at: RunState, signal: int) -> RunState:
    """Return the run after a grasp that cannot hold has opened; velocities go on."""
    name, settings = at.segment.signals.names[signal], at.segment.settings
    origin = Origin(just_after(at.now.t), at.now.state, at.now.memory)
    grasps = {arm: grasp for arm, grasp in at.checkpoint.grasps.items() if arm != name}
    segment = segment_with(at.segment, grasps, origin)
    chain = segment.environment.at(origin.t)[0]
    require_followed(chain, origin.state, settings.longest_step, settings.scheme)
    news = Occurrence(at.now.t, "release", name, f"'{name}' is released: it cannot hold")
    saved = replace(at.checkpoint, now=origin, tracker=at.checkpoint.tracker.without(signal))
    return _stretch_begins(segment, saved, segment.at(origin), NO_GAPS, [news])


def _stretch_begins(
    segment: Segment, saved: Checkpoint, now: Instant, gaps: Gaps, news: Sequence[Occurrence] = ()
) -> RunState:
    """Return the run at the beginning of a smooth stretch.

    Args:
        segment: the chain and what moves it.
        saved: what is known, `now` included.
        now: the instant.
        gaps: what projection found and left.
        news: what has just happened.
    """
    margins = segment.margins(now)
    tracker, further = saved.tracker.at(now.t, margins, segment.signals, now)
    begun: dict[str, Any] = {
        "previous": None,
        "tail_time": now.t,
        "tail": margins[:0],
        "grasps": segment.environment.chain.grasps,
        "generic_rank": segment.generic_rank,
        "proposal": first_proposal(now) if segment.settings.scheme.adaptive else None,
        "tracker": tracker,
        "occurrences": (*saved.occurrences, *news, *further),
    }
    return RunState(segment, replace(saved, **begun), now, None, gaps, np.array([now.t]), margins[None])
