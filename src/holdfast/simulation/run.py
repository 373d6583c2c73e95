"""A run from its start to its end, with a sample recorded at every accepted instant.

Its transitions are a step, a jump, a grasp that opens, and the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from holdfast.dynamics.contact.touching_chain import require_outside
from holdfast.dynamics.near_singular import NEAR_SINGULAR, nearly_lost, weakest_strength
from holdfast.errors import HoldfastError
from holdfast.model.grasp_rows import row_name
from holdfast.simulation.adaptive import first_proposal
from holdfast.simulation.balance import Sums
from holdfast.simulation.checkpoint import Checkpoint, Origin
from holdfast.simulation.contact_events import reached, require_progress, with_modes
from holdfast.simulation.events import Attach, Occurrence
from holdfast.simulation.hand_events import slidable
from holdfast.simulation.impulse_stepper import ImpulseStepper
from holdfast.simulation.instant import Instant
from holdfast.simulation.margins import ViolationTracker
from holdfast.simulation.rollout.fused_stepper import MOST_TOGETHER
from holdfast.simulation.run_record import Listeners, RunRecord
from holdfast.simulation.run_step import RunState, stepped
from holdfast.simulation.segment import RunSettings, Segment, first_segment, resumed_segment, segment_with, suited
from holdfast.simulation.step import Gaps
from holdfast.simulation.stepper import NO_GAPS
from holdfast.simulation.stops import just_after
from holdfast.simulation.trajectory import Trajectory, part_of
from holdfast.simulation.uneventful import uneventful_steps
from holdfast.simulation.verification import PAST_JUMP
from holdfast.simulation.zero_order_hold import initial_hold, require_same
from holdfast.spatial.frozen import changed
from holdfast.spatial.spatial_vector import shift_wrench
from holdfast.state import State

# Strength of a direction: below it a singular configuration counts as the cause, above it as a possible one.
NEARLY_SINGULAR = 0.01
MOST_UNPLANNED = 1_000_000  # steps of an adaptive scheme beyond those at planned times; by itself it might never end
FEWEST_TOGETHER = 8  # steps that are tried together at least


def start_of_run(settings: RunSettings, state: State) -> RunState:
    """Return a run at its start.

    Raises:
        StateError: the state violates a grasp, a point is inside a shape, or the controller's torques have a wrong
            shape or are not finite.
        SingularChainError: the configuration is singular.
    """
    require_outside(settings.environment.chain_at(0.0), state)
    segment, news = suited(first_segment(settings, Origin(0.0, state, None)), 0.0, state)
    now, gaps = segment.stepper.start(0.0, state, None)
    held, memory = segment.sampled(0.0, now.state, initial_hold(settings.hold), None)
    origin = Origin(0.0, now.state, memory)
    sums = Sums(np.zeros(4), 0.0, np.zeros(6))
    segment, origin, sums, touches = with_modes(segment, origin, sums)
    now = now if held is None and segment.contacts is None else segment.at(origin)
    blank = ViolationTracker.blank(len(segment.signals))
    grasps, generic_rank = segment.environment.chain.grasps, segment.generic_rank
    saved = Checkpoint(origin, grasps, generic_rank, blank, held=held, sums=sums)
    return _stretch_begins(segment, saved, now, gaps, [*news, *touches])


def resumed_run(settings: RunSettings, at: Checkpoint) -> RunState:
    """Return a run that continues from a checkpoint.

    Raises:
        StateError: the sample time or the delay of the controller differs from that of the checkpoint.
    """
    require_same(settings.hold, at.held)
    hands = () if at.contacts is None else at.contacts.hands
    segment = resumed_segment(settings, at.grasps, at.generic_rank, at.implicit, hands)
    segment = replace(segment, contacts=at.contacts, least_gap=at.least_gap)
    stepper: Any = segment.stepper
    again = stepper.again if isinstance(stepper, ImpulseStepper) else stepper.evaluate
    now = again(at.now.t, at.now.state, at.now.memory)
    previous = at.previous if at.previous is None else again(at.previous.t, at.previous.state, at.previous.memory)
    return RunState(segment, at, now, previous, NO_GAPS, np.array([now.t]), segment.margins(now)[None])


def next_state(at: RunState) -> RunState | str | None:
    """Return the run one instant later, or the reason why it stops early, or None at its end.

    Raises:
        HoldfastError: no step is possible.
    """
    settings, signals, saved = at.segment.settings, at.segment.signals, at.checkpoint
    if at.ended is not None:
        return at.ended
    signal = at.violated()
    if signal is not None:
        if signals.quantities[signal] == "grasp" and settings.policy.on_slip == "release":
            return _opened(at, signal)
        slides = signals.quantities[signal] == "grasp" and settings.policy.on_slip == "slide"
        if slides and signals.names[signal] in slidable(at.segment):
            return _touched(at)
        if signal not in signals.logged:
            return _touched(at)
        reached = [one for one in saved.occurrences if one.name == signals.names[signal] and one.kind == "violation"]
        return f"{reached[-1].text} at t = {reached[-1].t:.12g} s"
    times, jumps = settings.stops
    stop = saved.stop
    while stop < len(times) and times[stop] <= at.now.t and not jumps[stop]:
        stop += 1
    if stop == len(times):
        return None
    at = at if stop == saved.stop else replace(at, checkpoint=replace(saved, stop=stop))
    return _jumped(at) if jumps[stop] else stepped(_sampled(at))


def _sampled(at: RunState) -> RunState:
    """Return the run after sampling its controller, if a sample is due at a time without a jump."""
    saved, now = at.checkpoint, at.now
    held, _ = at.segment.sampled(now.t, now.state, saved.held, now.memory)
    return at if held is saved.held else replace(at, checkpoint=replace(saved, held=held))


def _jumped(at: RunState) -> RunState:
    """Return the run on the other side of a breakpoint, after the events of that time."""
    segment, saved = at.segment, at.checkpoint
    settings, before = segment.settings, segment.environment.chain
    t = float(settings.stops.times[saved.stop])
    t = t if t > at.now.t else just_after(at.now.t)  # if a grasp has just opened at that time
    chain = segment.environment.chain_at(t)
    state, sums, tracker = at.now.state, saved.sums, saved.tracker
    happening = [event for event in settings.events[saved.event :] if event.t <= t]
    news = []
    for event in happening:
        _, inputs = segment.environment.at(t, state)
        chain, state, one = segment.happen(event, chain, state, inputs)
        base_impulse = sums.base_impulse
        for (name, arm), impulse in zip(chain.arms.items(), one.base_impulses, strict=False):
            if name not in chain.mounts:
                base_impulse = base_impulse + shift_wrench(arm.base.p, np.array(impulse))
        if chain.trunk is not None and one.trunk_base_impulse:  # zero for a floating base
            base_impulse = base_impulse + shift_wrench(chain.trunk.base.p, np.array(one.trunk_base_impulse))
        sums = sums._replace(impact=sums.impact + one.energy_change, base_impulse=base_impulse)
        news.append(one)
    origin, gaps = Origin(t, state, at.now.memory), NO_GAPS
    if happening:
        sliding = tuple(hand for hand in segment.hands if hand.arm not in {event.arm for event in happening})
        segment, stiff = suited(segment_with(segment, chain.grasps, origin, sliding), t, state)
        news += stiff
    if any(isinstance(event, Attach) for event in happening):
        started, gaps = segment.stepper.start(t, state, origin.memory)
        origin = replace(origin, state=started.state)
    held, memory = segment.sampled(t, origin.state, saved.held, origin.memory)
    origin = replace(origin, memory=memory)
    segment, origin, sums, touches = with_modes(segment, origin, sums, at.now.touch)
    now = segment.at(origin)
    for key in set(before.grasps) - set(chain.grasps):
        tracker = tracker.without(segment.signals.names.index(row_name(key)))
    happened = saved.event + len(happening)
    saved = replace(saved, now=origin, stop=saved.stop + 1, event=happened, sums=sums, tracker=tracker, held=held)
    return _stretch_begins(segment, saved, now, gaps, [*news, *touches])


def _opened(at: RunState, signal: int) -> RunState:
    """Return the run after a grasp that cannot hold has opened; velocities stay the same."""
    name = at.segment.signals.names[signal]
    origin = Origin(just_after(at.now.t), at.now.state, at.now.memory)
    grasps = {key: grasp for key, grasp in at.checkpoint.grasps.items() if row_name(key) != name}
    segment, stiff = suited(segment_with(at.segment, grasps, origin), origin.t, origin.state)
    news = Occurrence(at.now.t, "release", name, f"'{name}' is released: it cannot hold")
    segment, origin, sums, touches = with_modes(segment, origin, at.checkpoint.sums, at.now.touch)
    saved = replace(at.checkpoint, now=origin, tracker=at.checkpoint.tracker.without(signal), sums=sums)
    return _stretch_begins(segment, saved, segment.at(origin), NO_GAPS, [news, *stiff, *touches])


def _touched(at: RunState) -> RunState:
    """Return the run after an instant at which contacts with the world or hands change their modes."""
    now = at.now
    require_progress(at.checkpoint.occurrences)
    by = reached(at.segment, now, at.margins[-1])
    origin = Origin(just_after(now.t), now.state, now.memory)
    segment, origin, sums, news = with_modes(at.segment, origin, at.checkpoint.sums, now.touch, by)
    tracker = at.checkpoint.tracker
    for name in by.spent:
        tracker = tracker.without(segment.environment.chain.names.index(name))
    saved = replace(at.checkpoint, now=origin, sums=sums, tracker=tracker)
    return _stretch_begins(segment, saved, segment.at(origin), NO_GAPS, news)


def _stretch_begins(
    segment: Segment, saved: Checkpoint, now: Instant, gaps: Gaps, news: Sequence[Occurrence] = ()
) -> RunState:
    """Return the run at the beginning of a smooth stretch.

    Args:
        segment: the current segment of the run.
        saved: the checkpoint, with its entry `now` updated.
        now: the instant.
        gaps: position and velocity gaps before and after projection.
        news: occurrences to add.
    """
    margins = segment.margins(now)
    tracker, further = saved.tracker.sized(len(segment.signals)).at(now.t, margins, segment.signals, now)
    saved = replace(
        saved,
        previous=None,
        tail_time=now.t,
        tail=margins[:0],
        grasps=segment.environment.chain.grasps,
        generic_rank=segment.generic_rank,
        implicit=segment.implicit,
        contacts=segment.contacts,
        least_gap=segment.least_gap,
        proposal=first_proposal(now) if segment.settings.scheme.adaptive else None,
        tracker=tracker,
        occurrences=(*saved.occurrences, *news, *further),
    )
    return RunState(segment, saved, now, None, gaps, np.array([now.t]), margins[None])


def recorded_run(at: RunState, resumed: bool, listeners: Listeners) -> Trajectory:
    """Return the samples of a run from a state to its end, and why it stopped, if it did.

    Args:
        at: where the run is.
        resumed: whether an earlier call recorded this state, so that the samples are those after it.
        listeners: functions to call on the way.
    """
    settings, record = at.segment.settings, RunRecord(at.segment.settings.recording, resumed, listeners)
    first = reported = len(at.checkpoint.occurrences) if resumed else 0
    longest = MOST_UNPLANNED + len(settings.stops.times)
    if not resumed:
        record.add(_sample(at, at.checkpoint.occurrences), lambda _: at.checkpoint)
        reported = len(at.checkpoint.occurrences)
    pace, taken = Pace(), int(not resumed)
    while True:
        stretch = uneventful_steps(at, pace.most) if pace.may_try() else None
        if stretch is not None:
            record.add(stretch.samples, stretch.checkpoint)
            pace.taken(stretch.steps, stretch.whole)
            at, taken = stretch.end, taken + 1
            listeners.progress(at.now.t)
            if stretch.interruption is not None:
                raise stretch.interruption
            continue
        later = next_or_reason(at)
        if not isinstance(later, RunState):
            break
        if taken > longest:
            later = f"stopped after t = {at.now.t:.6g} s: more than {MOST_UNPLANNED} steps; try a larger rtol"
            break
        saved = later.checkpoint
        pace.alone(saved.stop > at.checkpoint.stop)
        if later.now.t > at.now.t and not _is_past_jump(at, later):
            record.add(_sample(later, saved.occurrences[reported:]), lambda _, saved=saved: saved)
            reported = len(saved.occurrences)
            listeners.progress(later.now.t)
        at, taken = later, taken + 1
    found = record.whole(at.checkpoint)
    if found is None:  # resumed at its end
        found = part_of(_sample(at, ()), slice(0, 0))
    return changed(found, stopped=later, occurrences=at.checkpoint.occurrences[first:], every=settings.recording.every)


def _is_past_jump(at: RunState, later: RunState) -> bool:
    """Return whether a step only leads past a jump at which contacts change their modes; see `verify`."""
    return later.now.t - at.now.t <= PAST_JUMP and later.violated() in later.segment.of_modes


class Pace:
    """How many steps are tried together: twice as many as went well; none for a while after failure.

    Results do not change.

    Attributes:
        most: the largest number of steps to try.
    """

    def __init__(self) -> None:
        self.most, self._wait, self._failures = FEWEST_TOGETHER, 0, 0

    def may_try(self) -> bool:
        """Return whether to try; without `taken` after it, it has failed."""
        if self._wait:
            self._wait -= 1
            return False
        self._failures += 1
        self._wait = min(2**self._failures, MOST_TOGETHER) - 1
        return True

    def alone(self, planned: bool) -> None:
        """Take note of a step by itself; if it ended before its planned end, so is the next one."""
        self._wait = max(self._wait, int(not planned))

    def taken(self, count: int, whole: bool) -> None:
        """Take note that steps were taken together; if not all that were tried, the next one is taken by itself."""
        self._failures, self._wait = 0, int(not whole)
        self.most = min(max(2 * count, FEWEST_TOGETHER), MOST_TOGETHER)


def _sample(at: RunState, happened: tuple[Occurrence, ...]) -> Trajectory:
    """Return the run of one sample at an accepted instant."""
    return at.segment.sample(at.now, at.gaps, at.checkpoint.sums, at.times, at.margins, happened)


def next_or_reason(at: RunState) -> RunState | str | None:
    """Return the run one instant later, the reason why it must stop, or None at its end."""
    try:
        return next_state(at)
    except HoldfastError as cause:
        why = reason(cause, at.now, at.previous) if at.segment.finds_singular else str(cause)
        return f"stopped after t = {at.now.t:.6g} s: {why}"


def reason(cause: HoldfastError, last: Instant, previous: Instant | None) -> str:
    """Return why a step failed: first that the last sample is nearly singular, if it is or the next would be.

    Args:
        cause: the error that the step raised.
        last: the chain at the last accepted instant.
        previous: the chain one step earlier; None if `last` begins a smooth stretch.
    """
    near = nearly_lost(last.chain, last.state, NEAR_SINGULAR)
    if not near:
        return str(cause)
    strength = weakest_strength(last.chain, last.state)
    earlier = 0.0 if previous is None else weakest_strength(previous.chain, previous.state)
    if strength > NEARLY_SINGULAR and 2.0 * strength**2 > earlier**2:  # its square falls evenly at a steady speed
        return f"{cause}. The last configuration is also near a singular one: {'; '.join(near)}"
    what = str(cause).partition("; try ")[0]
    return (
        f"nearly singular, where joint rates and forces grow without bound: {'; '.join(near)}. Try a motion that keeps"
        f" away from this configuration. There, {what}"
    )
