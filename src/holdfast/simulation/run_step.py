"""The state of a run, and one step: verified margins, the search for singular configurations, a check of its length."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from holdfast.dynamics.contact.fixed_modes import ContactModes
from holdfast.errors import HoldfastError, StateError
from holdfast.simulation.adaptive import next_step
from holdfast.simulation.adaptive_parts import EqualPartsStepper, agreeing_parts
from holdfast.simulation.checkpoint import Checkpoint, Origin
from holdfast.simulation.confirmation import Window, explained, require_shown, resolved, too_long
from holdfast.simulation.contact_events import changes
from holdfast.simulation.events import Occurrence
from holdfast.simulation.instant import Instant
from holdfast.simulation.margins import ViolationTracker
from holdfast.simulation.mechanism_margins import MechanismSignals
from holdfast.simulation.mechanism_stepper import MechanismStepper
from holdfast.simulation.rollout.python_law_stepper import PythonLawStepper
from holdfast.simulation.segment import Segment, suited
from holdfast.simulation.singular_configuration import (
    ALMOST,
    CLOSED_PATH,
    SHORTENED_WITHIN,
    SingularConfiguration,
    configuration_ahead,
    configurations_passed,
    length_through,
    may_be_unresolved,
    may_lose_rank,
    time_left,
)
from holdfast.simulation.stability import elsewhere
from holdfast.simulation.step import Gaps
from holdfast.simulation.stepper import NO_GAPS, Advance, Stepper
from holdfast.simulation.verification import (
    MarginCurves,
    StepMargins,
    verified_by_screening,
    verified_without_steps,
    verify,
    without_events,
)
from holdfast.spatial.scalar import Array

TURNING = 0.5  # longest step, relative to the time in which friction turns a slip
SHORTEST_TURN = 1e-9  # s: the shortest step for that
LARGEST_RATE = 1e30  # rad/s or m/s: the squares of faster rates soon overflow float64


@dataclass(frozen=True, eq=False)
class RunState:
    """A run at one accepted instant.

    Attributes:
        segment: the current segment of the run.
        checkpoint: the data from which the run can be continued.
        now: the instant, evaluated from `checkpoint.now`.
        previous: the previous instant, evaluated from `checkpoint.previous`; None if `now` begins a smooth stretch.
        gaps: position and velocity gaps before and after projection.
        times: (k,) times since the previous instant at which the margins were evaluated [s].
        margins: (k, signals) margins at these times; the last row belongs to `now`.
        ended: the reason if the run ends here, otherwise None.
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
        """Return the most negative signal among those at which the run does not simply continue; None if none is."""
        acting, now = self.segment.acting, self.margins[-1]
        if not len(acting) or now[acting].min() >= 0.0:
            return None
        return int(acting[np.argmin(now[acting])])


def stepped(at: RunState) -> RunState:
    """Return the run after a step, or ended before a singular configuration that it may not pass."""
    segment, now, settings = at.segment, at.now, at.segment.settings
    until = _followed(now, float(settings.stops.times[at.checkpoint.stop]))
    if not segment.finds_singular:
        return _step_to(at, until)
    goes_on = settings.policy.on_singular == "continue"
    proposal = at.checkpoint.proposal
    step = settings.longest_step if proposal is None else proposal.step
    left = time_left(segment, now, step) if goes_on else None
    if left is not None and (proposal is not None or left <= SHORTENED_WITHIN * step):  # no step should end close to it
        return _towards(at, left, step)
    later, configuration = _step_and_configuration(at, until)
    if configuration is None:
        assert later is not None
        return later
    if goes_on and configuration.unique:
        return _towards(at, configuration.t - now.t, step)
    return _ended(at, configuration)


def _followed(now: Instant, until: float) -> float:
    """Return the end of a step in which friction can turn with slips; it turns without bound where one stops."""
    if now.touch is None:
        return until
    return min(until, now.t + max(TURNING * now.touch.turning_time, SHORTEST_TURN))


def _step_and_configuration(at: RunState, until: float) -> tuple[RunState | None, SingularConfiguration | None]:
    """Return the run after a step (None if it fails), and the first singular configuration that the step passes.

    Near a singular configuration, a fixed step that is too long for the motion is taken in parts.
    """
    segment, now = at.segment, at.now
    later, failure = None, None
    try:
        later = _step_to(at, until)
        configuration = _first_configuration(segment, now, later.now)
    except HoldfastError as cause:
        failure, configuration = cause, configuration_ahead(segment, now, until)
    leaps = configuration is not None and configuration.gap > CLOSED_PATH
    finer = None
    if (configuration is None or leaps) and not segment.scheme.adaptive:
        finer = _finer(at, until, later, leaps)
    if finer is not None:
        try:
            later = _step_to(at, until, stepper=finer)
        except HoldfastError as cause:
            failure = failure or cause
        else:
            return later, _first_configuration(segment, now, later.now)
    if failure is not None and configuration is None:
        raise failure
    return later, configuration


def _first_configuration(segment: Segment, now: Instant, later: Instant) -> SingularConfiguration | None:
    """Return the first singular configuration between two instants."""
    return next(configurations_passed(segment, now, later), None)


def _finer(at: RunState, until: float, later: RunState | None, leaps: bool) -> Stepper | None:
    """Return the stepper for a fixed step that is too long near a singular configuration; None if it is short enough.

    Args:
        at: the run.
        until: the step's end [s].
        later: the run after the step; None if the step fails.
        leaps: whether the step leads from one branch of the motion to another.
    """
    segment, now = at.segment, at.now
    if later is None:
        return segment.varied_parts if may_lose_rank(now, until) else None
    if not may_be_unresolved(at.previous, now, later.now):
        return None
    parts = None if leaps else agreeing_parts(segment.stepper, now, later.now)
    if parts is None:
        return segment.varied_parts
    return None if parts == 1 else EqualPartsStepper(segment.stepper, (later.now.t - now.t) / parts)


def _towards(at: RunState, left: float, step: float) -> RunState:
    """Return the run after a step that ends before a singular configuration or passes through it.

    Args:
        at: the run.
        left: time until the configuration is reached [s].
        step: greatest length of the step [s].
    """
    now, segment = at.now, at.segment
    if left > ALMOST * step:  # a step that ends half a step before it, or sooner
        if at.checkpoint.proposal is None:
            return _step_to(at, now.t + left - 0.5 * step)
        return _step_to(at, _latest(at), lambda tried: min(tried, left - 0.5 * tried))
    until = min(now.t + length_through(left, step), _latest(at))
    later = _step_to(at, until, stepper=segment.collocation)
    passed = list(configurations_passed(segment, now, later.now))  # empty if the motion has turned back before it
    branching = [configuration for configuration in passed if not configuration.unique]
    return _ended(at, branching[0]) if branching else _passed(at, later, passed)


def _latest(at: RunState) -> float:
    """Return the time that no step may pass: the next jump, the next controller sample, or the run's end [s]."""
    times, jumps = at.segment.settings.stops
    jumping = np.flatnonzero(jumps[at.checkpoint.stop :])
    latest = float(times[at.checkpoint.stop + jumping[0] - 1] if len(jumping) else times[-1])
    hold, held = at.segment.settings.hold, at.checkpoint.held
    if hold is None or held is None or held.asked == len(hold.asked):
        return latest
    return min(latest, float(hold.asked[held.asked]))


def _passed(at: RunState, later: RunState, configurations: Sequence[SingularConfiguration]) -> RunState:
    """Return the run after a step through singular configurations."""
    before, after = (one.checkpoint.occurrences for one in (at, later))
    crossed = [configuration.occurrence("passes a singular configuration") for configuration in configurations]
    news = sorted([*after[len(before) :], *crossed], key=lambda one: one.t)
    return replace(later, checkpoint=replace(later.checkpoint, occurrences=(*before, *news)))


def _ended(at: RunState, configuration: SingularConfiguration) -> RunState:
    """Return the run, ended before a singular configuration."""
    occurrence = configuration.occurrence("stops before a singular configuration")
    saved = replace(at.checkpoint, occurrences=(*at.checkpoint.occurrences, occurrence))
    where = f"stopped after t = {at.now.t:.6g} s, before a singular configuration at t = {configuration.t:.9g} s"
    return replace(at, checkpoint=saved, ended=f"{where}: {configuration.text}{_branches(at, configuration)}")


def _branches(at: RunState, configuration: SingularConfiguration) -> str:
    """Return why the run does not continue through the configuration although its policy allows it; else ''."""
    if configuration.unique or at.segment.settings.policy.on_singular == "stop":
        return ""
    if configuration.gap > CLOSED_PATH:
        return f". The grasps would be open by {configuration.gap:.3g} (m or rad) there: try smaller steps"
    return ". The constraint has its rank again on the same side: more than one motion leads on from there"


def _step_to(
    at: RunState, until: float, placed: Callable[[float], float] | None = None, stepper: Stepper | None = None
) -> RunState:
    """Return the run after a step, which ends early if a margin that acts becomes negative.

    Args:
        at: the run.
        until: the step's end, or the time that an adaptive step must not pass [s].
        placed: lengths of adaptive steps, as for `next_step`.
        stepper: takes the step instead of the segment's stepper.
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
    times = segment.evaluation_times(now.t, until)
    by = stepper or segment.stepper
    found = _screened(curves, at, by, times) or _interpolated(curves, at, by, times)
    if found is None:
        found = verify(curves, now.t, times, signals.limited, segment.acting, saved.tracker.lowest, segment.of_modes)
    end = found.end
    straight = now.touch is not None and now.touch.modes_within(until - now.t).straight
    window = Window(segment, None if straight else at.previous, now)  # a slip comes into its direction in short steps
    _require_step(window, found, until, saved.tracker)
    assert end.instant is not None
    tracker, news = saved.tracker.after(found, curves, signals)
    margins = found.margins[min(found.start, 1) :]  # the row before the start belongs to the previous instant
    if end.t == now.t:  # a dip just before the start was found only in this step
        margins = margins.min(axis=0, keepdims=True)
    tail_time = times[-2] if len(times) > 1 else now.t
    resolution = saved.resolution
    by_impulses = settings.by_impulses and now.touch is not None
    if by_impulses and segment.environment.chain.touching is not None:
        news = [*news, *changes(now, end.instant, segment.environment.chain.touching.names)]
    if stepper is None and not settings.scheme.adaptive and end.t == until and not by_impulses:
        resolution = resolved(resolution, window, end.instant)
        if end.t == settings.stops.times[-1] and resolution.matters:
            news = [*news, Occurrence(end.t, "unresolved", "joints", resolution.text)]
    if elsewhere(now.state, end.instant.state):
        segment, stiff = suited(segment, end.t, end.instant.state)
        news = [*news, *stiff]
    checkpoint = replace(
        saved,
        now=Origin(end.t, end.instant.state, now.memory),
        previous=saved.now,
        tail_time=tail_time,
        tail=curves.margins[tail_time if tail_time in curves.margins else now.t],
        stop=saved.stop + int(end.t == next_stop),
        sums=saved.sums._replace(work=saved.sums.work + end.work),
        proposal=proposal,
        implicit=segment.implicit,
        tracker=tracker,
        occurrences=(*saved.occurrences, *news),
        resolution=resolution,
        contacts=_modes_before(segment, now, end.instant),
    )
    return RunState(segment, checkpoint, end.instant, now, end.gaps, found.times[-len(margins) :], margins)


def _modes_before(segment: Segment, now: Instant, end: Instant) -> ContactModes | None:
    """Return the modes from which a step's end is evaluated: those at its start, or those of its own impulses."""
    if now.touch is None or end.touch is None:
        return None
    return end.touch.modes if segment.settings.by_impulses else now.touch.modes_within(end.t - now.t)


def _require_step(window: Window, found: StepMargins, until: float, tracker: ViolationTracker) -> None:
    """Raise an error if the step failed, or if it has a fixed length that is too long for the motion.

    Args:
        window: the step and the one before it.
        found: the margins during the step, and its end.
        until: the requested end [s].
        tracker: the margins before the step.

    Raises:
        StepTooLongError: the step diverges, or shorter steps do not confirm its result.
        HoldfastError: the error with which the step failed.
    """
    settings, end = window.segment.settings, found.end
    if end.instant is None:
        assert end.failure is not None
        raise end.failure if settings.scheme.adaptive else explained(window, until, end.failure)
    state = end.instant.state
    if not np.abs(state.qd).max(initial=0.0) < LARGEST_RATE:
        why = f"the motion diverges, a joint rate passes {LARGEST_RATE:g}"
        raise StateError(why) if settings.scheme.adaptive else too_long(window, until, why)
    if not settings.scheme.adaptive:
        require_shown(window, found, tracker)


def _screened(curves: MarginCurves, at: RunState, stepper: Stepper, times: list[float]) -> StepMargins | None:
    """Return the margins of a step under Python functions that are called at its stages only, and enter them.

    None if one is in doubt.
    """
    if not isinstance(stepper, PythonLawStepper) or len(times) == 1:
        return None
    segment, now, previous, tracker = at.segment, at.now, at.previous, at.checkpoint.tracker

    def reach(points: Sequence[float]) -> list[Advance]:
        before, after = [t for t in points if t < now.t], [t for t in points if t >= now.t]
        led = [] if previous is None or not before else stepper.screened(previous, [*before, now.t])[:-1]
        return led + (stepper.screened(now, sorted({*after, times[-1]}))[: len(after)] if after else [])

    between = MarginCurves(reach, segment.margins_of, dict(curves.margins), dict(curves.advances))
    watched = segment.signals.limited
    if not verified_by_screening(between, now.t, times, watched, tracker.beyond, tracker.lowest):
        return None
    return _verified(curves, between, at, between.advances[times[-1]])


def _interpolated(curves: MarginCurves, at: RunState, stepper: Stepper, times: list[float]) -> StepMargins | None:
    """Return the margins of a step of a chain that is answered as a forest, and enter them; None if one is in doubt.

    Each of the points inside a step would cost a step. They lie on the quintics through the ends of the steps instead.
    """
    if not isinstance(stepper, MechanismStepper) or len(times) == 1:
        return None
    try:
        curves.evaluate(times[-1:])
    except HoldfastError:
        return None
    segment, tracker, end = at.segment, at.checkpoint.tracker, curves.advances[times[-1]]
    assert end.instant is not None and isinstance(segment.signals, MechanismSignals)
    watched, known = segment.signals.limited, curves.margins
    rough = stepper.margins_between(at.now, end.instant, times[:-1], segment.signals)
    if rough is not None:
        tried = replace(curves, margins=known | dict(zip(times, rough, strict=False)))
        if without_events(*tried.table(), at.now.t, watched, tracker.beyond, tracker.lowest):
            return _verified(curves, tried, at, end)
    inside = stepper.between(at.now, end.instant)
    before = inside if at.previous is None else stepper.between(at.previous, at.now)

    def reach(points: Sequence[float]) -> list[Advance]:
        return [Advance(t, (before if t < at.now.t else inside)(t), NO_GAPS, np.zeros(4)) for t in points]

    between = MarginCurves(reach, segment.margins_of, dict(known), {})
    if not verified_without_steps(between, at.now.t, times, watched, tracker.beyond, tracker.lowest):
        return None
    return _verified(curves, between, at, end)


def _verified(curves: MarginCurves, between: MarginCurves, at: RunState, end: Advance) -> StepMargins:
    """Return the margins of a step that are known without further steps, and enter them."""
    curves.margins.update(between.margins)
    found, margins = between.table()
    return StepMargins(found, margins, int(np.searchsorted(found, at.now.t)), end)


def _margin_curves(at: RunState, stepper: Stepper) -> MarginCurves:
    """Return the margin curves around the current instant, with the margins known so far."""
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
    return MarginCurves(reach, at.segment.margins_of, known, {now.t: here})
