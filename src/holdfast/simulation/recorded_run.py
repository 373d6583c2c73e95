"""A run taken to its end, with a sample recorded at every accepted instant."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

from holdfast.dynamics.near_singular import NEAR_SINGULAR, nearly_lost
from holdfast.errors import HoldfastError
from holdfast.simulation.checkpoint import Checkpoint
from holdfast.simulation.instant import Instant
from holdfast.simulation.run import next_state
from holdfast.simulation.run_step import RunState
from holdfast.simulation.sample import Recorder
from holdfast.simulation.stops import MOST_STEPS
from holdfast.simulation.trajectory import Trajectory, array_names, stacked

# Strength of a direction: below it a singular configuration counts as the cause, above it as a possible one.
SINGULAR = 0.01


class Listeners(NamedTuple):
    """Functions that are called while a run goes on; see `simulate`.

    Attributes:
        progress: called with the time after every step.
        on_sample: each called with every sample.
        on_checkpoint: called after that with the checkpoint.
    """

    progress: Callable[[float], object]
    on_sample: Sequence[Callable[[Trajectory], None]]
    on_checkpoint: Callable[[Checkpoint], None] | None


def recorded_run(at: RunState, recorder: Recorder, resumed: bool, listeners: Listeners) -> Trajectory:
    """Return the samples of a run from a state to its end, and why it stopped, if it did.

    Args:
        at: where the run is.
        recorder: what makes the samples.
        resumed: whether an earlier call recorded this state, so that the samples are those after it.
        listeners: functions to call on the way.
    """
    samples: list[Trajectory] = []
    first = reported = len(at.checkpoint.occurrences) if resumed else 0
    longest = MOST_STEPS + len(at.segment.settings.stops.times)  # an adaptive scheme by itself might never end

    def record(at: RunState) -> None:
        nonlocal reported
        happened = at.checkpoint.occurrences[reported:]
        reported += len(happened)
        samples.append(recorder.sample(at.now, at.gaps, at.checkpoint.sums, at.times, at.margins, happened))
        for listen in listeners.on_sample:
            listen(samples[-1])
        if listeners.on_checkpoint is not None:
            listeners.on_checkpoint(at.checkpoint)

    if not resumed:
        record(at)
    while isinstance(later := next_or_reason(at), RunState):
        if len(samples) > longest:
            later = f"stopped after t = {at.now.t:.6g} s: more than {MOST_STEPS} steps; try a larger rtol"
            break
        if later.now.t > at.now.t:
            record(later)
            listeners.progress(later.now.t)
        at = later
    if samples:
        return replace(stacked(samples, later), occurrences=at.checkpoint.occurrences[first:])
    last = stacked([recorder.sample(at.now, at.gaps, at.checkpoint.sums, at.times, at.margins)], later)
    return replace(last, **{name: getattr(last, name)[:0] for name in array_names()})  # resumed at its end


def next_or_reason(at: RunState) -> RunState | str | None:
    """Return the run one instant later, the reason why it must stop, or None at its end."""
    try:
        return next_state(at)
    except HoldfastError as cause:
        return f"stopped after t = {at.now.t:.6g} s: {reason(cause, at.now)}"


def reason(cause: HoldfastError, last: Instant) -> str:
    """Return why a step failed, with the directions in which the last sample is nearly singular.

    Args:
        cause: the error that the step raised.
        last: the chain at the last accepted instant.
    """
    lost = nearly_lost(last.chain, last.state, SINGULAR)
    if lost:
        what = str(cause).partition("; try ")[0]
        return (
            f"{what}. The last configuration is nearly singular, where joint rates and forces grow without bound:"
            f" {'; '.join(lost)}. Try a motion that keeps away from it"
        )
    near = nearly_lost(last.chain, last.state, NEAR_SINGULAR)
    return f"{cause}. The last configuration is also near a singular one: {'; '.join(near)}" if near else str(cause)
