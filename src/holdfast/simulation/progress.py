"""Where a run is, and what comes next: a step, a jump, a grasp that opens, the end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from holdfast.errors import StateError
from holdfast.simulation.adaptive import Proposal, first_proposal, next_step
from holdfast.simulation.checkpoint import Checkpoint, Origin
from holdfast.simulation.confirmation import Window, explained, require_shown, too_long
from holdfast.simulation.events import Attach, happen
from holdfast.simulation.instant import Instant
from holdfast.simulation.ledger import Ledger
from holdfast.simulation.leg import Leg, Plan, first_leg, leg_with, resumed_leg
from holdfast.simulation.occurrence import Occurrence
from holdfast.simulation.sample import Sums
from holdfast.simulation.stability import elsewhere, require_followed
from holdfast.simulation.step import Gaps
from holdfast.simulation.stepper import NO_GAPS, Advance
from holdfast.simulation.stops import just_after
from holdfast.simulation.verification import Course, Found, look_times, verify
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import shift_wrench
from holdfast.state import State

FASTEST = 1e30  # rad/s or m/s: what is faster ends in numbers that are none


@dataclass(frozen=True, eq=False)
class Progress:
    """A run at one accepted instant.

    Attributes:
        leg: the chain and what moves it.
        now: the instant.
        origin: what it was made from.
        gaps: what projection found and left.
        times: (looks,) at which margins were looked at since the instant before [s].
        margins: (looks, signals) then; the last are those of now.
        previous: the instant before and what it was made from; None where now begins a smooth stretch.
        tail_time: the last look before now [s].
        tail: (signals,) then.
        stop: index of the next stop.
        event: index of the next event.
        sums: what has gone into the chain since the start.
        proposal: of the step size control.
        ledger: margins since the start.
        occurrences: since the start.
    """

    leg: Leg
    now: Instant
    origin: Origin
    gaps: Gaps
    times: Array
    margins: Array
    previous: tuple[Instant, Origin] | None
    tail_time: float
    tail: Array
    stop: int
    event: int
    sums: Sums
    proposal: Proposal | None
    ledger: Ledger
    occurrences: tuple[Occurrence, ...]

    def checkpoint(self) -> Checkpoint:
        """Return what the run can go on from."""
        leg, sums = self.leg, self.sums
        return Checkpoint(
            now=self.origin,
            previous=None if self.previous is None else self.previous[1],
            tail_time=self.tail_time,
            tail=self.tail,
            stop=self.stop,
            event=self.event,
            grasps=leg.environment.chain.grasps,
            generic_rank=leg.generic_rank,
            work=sums.work,
            impact=sums.impact,
            base_impulse=sums.base_impulse,
            occurrences=self.occurrences,
            proposal=self.proposal,
            ledger=self.ledger,
        )

    def violated(self) -> int | None:
        """Return the signal most below zero, of those that a run does not go on with."""
        acting, now = self.leg.acting, self.margins[-1]
        if not len(acting) or now[acting].min() >= 0.0:
            return None
        return int(acting[np.argmin(now[acting])])


def begun(plan: Plan, state: State) -> Progress:
    """Return the beginning of a run.

    Raises:
        StateError: the state breaks a grasp, or the controller's torques do not fit.
        StepTooLongError: no explicit step of this length can follow the joints' damping.
        SingularChainError: the configuration is singular.
    """
    leg = first_leg(plan, Origin(0.0, state, None))
    require_followed(plan.environment.at(0.0)[0], state, plan.longest_step, plan.scheme)
    now, gaps = leg.stepper.start(0.0, state, None)
    sums = Sums(np.zeros(4), 0.0, np.zeros(6))
    ledger = Ledger.blank(len(leg.signals))
    return _arrived(leg, now, Origin(0.0, now.state, None), gaps, 0, 0, sums, ledger, ())


def resumed(plan: Plan, at: Checkpoint) -> Progress:
    """Return a run at a checkpoint."""
    leg = resumed_leg(plan, at.grasps, at.generic_rank)
    now = leg.at(at.now)
    return Progress(
        leg=leg,
        now=now,
        origin=at.now,
        gaps=NO_GAPS,
        times=np.array([now.t]),
        margins=_margins(leg, now)[None],
        previous=None if at.previous is None else (leg.at(at.previous), at.previous),
        tail_time=at.tail_time,
        tail=at.tail,
        stop=at.stop,
        event=at.event,
        sums=Sums(at.work, at.impact, at.base_impulse),
        proposal=at.proposal,
        ledger=at.ledger,
        occurrences=at.occurrences,
    )


def following(at: Progress) -> Progress | str | None:
    """Return the run one instant later; the reason why it must stop; or None at its end.

    Raises:
        HoldfastError: the chain cannot go on.
    """
    plan, signals = at.leg.plan, at.leg.signals
    signal = at.violated()
    if signal is not None:
        if signals.quantities[signal] == "grasp" and plan.policy.on_slip == "release":
            return _opened(at, signal)
        reached = [one for one in at.occurrences if one.name == signals.names[signal] and one.kind == "violation"]
        return f"{reached[-1].text} at t = {reached[-1].t:.12g} s"
    times, jumps = plan.stops
    while at.stop < len(times) and times[at.stop] <= at.now.t and not jumps[at.stop]:
        at = replace(at, stop=at.stop + 1)
    if at.stop == len(times):
        return None
    return _jumped(at) if jumps[at.stop] else _stepped(at)


def _stepped(at: Progress) -> Progress:
    """Return the run after a step, to the next stop or to where a margin becomes negative that acts."""
    leg, now = at.leg, at.now
    stop, proposal = float(leg.plan.stops.times[at.stop]), at.proposal
    course = _course(at)
    if proposal is not None:
        reached, proposal = next_step(leg.stepper, now, proposal, stop)
        assert reached.instant is not None
        course.advances[reached.t] = reached
        course.margins[reached.t] = _margins(leg, reached.instant)
        stop = reached.t
    times = look_times(now.t, stop, leg.plan.scheme.c.tolist()) if len(leg.signals.limited) else [stop]
    found = verify(course, now.t, times, leg.signals.limited, leg.acting, at.ledger.lowest)
    end = found.end
    _require_step(at, found, stop)
    assert end.instant is not None
    ledger, news = at.ledger.after(found, course, leg.signals)
    first = min(found.start, 1)  # the look before belongs to the instant before
    margins = found.margins[first:]
    if end.t == now.t:  # a dip just before, found only now
        margins = margins.min(axis=0, keepdims=True)
    tail_time = times[-2] if len(times) > 1 else now.t
    return Progress(
        leg=leg,
        now=end.instant,
        origin=Origin(end.t, end.instant.state, now.memory),
        gaps=end.gaps,
        times=found.times[-len(margins) :],
        margins=margins,
        previous=(now, at.origin),
        tail_time=tail_time,
        tail=course.margins[tail_time if tail_time in course.margins else now.t],
        stop=at.stop + int(end.t == leg.plan.stops.times[at.stop]),
        event=at.event,
        sums=at.sums._replace(work=at.sums.work + end.work),
        proposal=proposal,
        ledger=ledger,
        occurrences=(*at.occurrences, *news),
    )


def _require_step(at: Progress, found: Found, until: float) -> None:
    """Refuse a step that failed, and one of fixed length that the motion is too fast for.

    Raises:
        StepTooLongError: shorter steps do not show what it shows, or could not follow either.
        HoldfastError: why no step leads on.
    """
    plan, end = at.leg.plan, found.end
    window = Window(at.leg, None if at.previous is None else at.previous[0], at.now)
    if end.instant is None:
        assert end.failure is not None
        raise end.failure if plan.scheme.adaptive else explained(window, until, end.failure)
    state = end.instant.state
    if not np.abs(state.qd).max() < FASTEST:
        why = f"the motion diverges, a joint rate passes {FASTEST:g}"
        raise StateError(why) if plan.scheme.adaptive else too_long(window, until, why)
    if plan.scheme.adaptive:
        return
    require_shown(window, found, at.ledger)
    if elsewhere(at.now.state, state):
        require_followed(end.instant.chain, state, plan.longest_step, plan.scheme)


def _course(at: Progress) -> Course:
    """Return the margins about now, so far as they are known."""
    leg, now = at.leg, at.now

    def reach(times: Sequence[float]) -> list[Advance]:
        before = [t for t in times if t < now.t]
        after = [t for t in times if t >= now.t]
        found = []
        if before:
            assert at.previous is not None
            found += leg.stepper.advance(at.previous[0], before)
        return found + (leg.stepper.advance(now, after) if after else [])

    known = {now.t: at.margins[-1]}
    if at.previous is not None:
        known[at.tail_time] = at.tail
    here = Advance(now.t, now, at.gaps, np.zeros(4))
    return Course(reach, lambda instant: _margins(leg, instant), known, {now.t: here})


def _jumped(at: Progress) -> Progress:
    """Return the run on the other side of a breakpoint, after the events of that time."""
    plan, leg = at.leg.plan, at.leg
    t = float(plan.stops.times[at.stop])
    t = t if t > at.now.t else just_after(at.now.t)  # where a grasp has opened just there
    chain, inputs = leg.environment.at(t)
    state, event, sums, news, gripped = at.now.state, at.event, at.sums, [], False
    while event < len(plan.events) and plan.events[event].t <= t:
        chain, state, one = happen(plan.events[event], chain, state, inputs)
        gripped = gripped or isinstance(plan.events[event], Attach)
        sums = sums._replace(impact=sums.impact + one.energy_change)
        for arm, impulse in zip(chain.arms.values(), one.base_impulses, strict=False):
            sums = sums._replace(base_impulse=sums.base_impulse + shift_wrench(arm.base.p, np.array(impulse)))
        news.append(one)
        event += 1
    origin, gaps = Origin(t, state, at.now.memory), NO_GAPS
    if news:
        leg = leg_with(leg, chain.grasps, origin)
        require_followed(chain, state, leg.plan.longest_step, leg.plan.scheme)
    now = leg.at(origin)
    if gripped:
        now, gaps = leg.stepper.start(t, state, origin.memory)
        origin = replace(origin, state=now.state)
    ledger = at.ledger
    for name in set(at.leg.environment.chain.grasps) - set(chain.grasps):
        ledger = ledger.without(chain.names.index(name))
    return _arrived(leg, now, origin, gaps, at.stop + 1, event, sums, ledger, (*at.occurrences, *news))


def _opened(at: Progress, signal: int) -> Progress:
    """Return the run after a grasp that cannot hold has opened; velocities go on."""
    name = at.leg.signals.names[signal]
    origin = Origin(just_after(at.now.t), at.now.state, at.now.memory)
    grasps = {arm: grasp for arm, grasp in at.leg.environment.chain.grasps.items() if arm != name}
    leg = leg_with(at.leg, grasps, origin)
    require_followed(leg.environment.at(origin.t)[0], origin.state, leg.plan.longest_step, leg.plan.scheme)
    news = Occurrence(at.now.t, "release", name, f"'{name}' is released: it cannot hold")
    ledger = at.ledger.without(signal)
    now = leg.at(origin)
    return _arrived(leg, now, origin, NO_GAPS, at.stop, at.event, at.sums, ledger, (*at.occurrences, news))


def _arrived(
    leg: Leg,
    now: Instant,
    origin: Origin,
    gaps: Gaps,
    stop: int,
    event: int,
    sums: Sums,
    ledger: Ledger,
    occurrences: tuple[Occurrence, ...],
) -> Progress:
    """Return the run at the beginning of a smooth stretch."""
    margins = _margins(leg, now)
    ledger, news = ledger.at(now.t, margins, leg.signals, now)
    adaptive = leg.plan.scheme.adaptive
    return Progress(
        leg=leg,
        now=now,
        origin=origin,
        gaps=gaps,
        times=np.array([now.t]),
        margins=margins[None],
        previous=None,
        tail_time=now.t,
        tail=margins[:0],
        stop=stop,
        event=event,
        sums=sums,
        proposal=first_proposal(now) if adaptive else None,
        ledger=ledger,
        occurrences=(*occurrences, *news),
    )


def _margins(leg: Leg, at: Instant) -> Array:
    """Return all margins at an instant; nothing is computed where nothing limits."""
    return leg.signals.of(at) if len(leg.signals.limited) else np.full(len(leg.signals), np.inf)
