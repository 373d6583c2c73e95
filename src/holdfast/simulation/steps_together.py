"""Fixed steps that machine code takes one after another, and the margins at points inside them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from holdfast.questions.arrays import FLOATING, STATE, state_of
from holdfast.simulation.rollout.fused_stepper import MODES, FusedStepper
from holdfast.simulation.rollout.kernel import Systems
from holdfast.simulation.rollout.python_law_stepper import PythonLawStepper
from holdfast.simulation.rollout.rows import ACCELERATIONS
from holdfast.simulation.rollout.successive_steps import Again
from holdfast.simulation.run_step import RunState
from holdfast.simulation.segment import Segment
from holdfast.simulation.stepper import SubdividingStepper
from holdfast.simulation.verification import evaluation_parts
from holdfast.simulation.zero_order_hold import HeldTorques
from holdfast.spatial.scalar import Array

# what is needed of a step's start, to take the step again and to judge it
OF_STARTS = (
    *STATE,
    *FLOATING,
    "slope",
    "memory",
    "held_rows",
    "condition",
    *ACCELERATIONS,
    *MODES,
    "touch_turning",
    "touch_stops",
)


class StepsTogether(NamedTuple):
    """Steps that machine code has taken one after another, whatever happens in them.

    Attributes:
        times: (k, points + 1) the start of each step, and the points at which it was evaluated, the last its end [s].
        jumps: (k,) whether torques or inputs jump at the start.
        points: results at the points, (k, points, ...) by name.
        starts: results at the start, (k, ...) by name: those in `OF_STARTS`.
        after_jumps: results at those starts that follow a jump, (k, 1, ...) by name; those of other steps mean nothing.
        margins: (points + 2, k, signals) margins before the start, at it, and at the points; minus infinity before a
            start without an evaluation that belongs to the same smooth stretch.
        again: as in `Taken`.
        held: the state of a sampled controller during each step.
        failed: number of the step before which the controller raised an error; k if it did not.
        memories, interruption: as in `Taken`.
    """

    times: Array
    jumps: Array
    points: Mapping[str, Array]
    starts: Mapping[str, Array]
    after_jumps: Mapping[str, Array]
    margins: Array
    again: Again
    held: Sequence[HeldTorques | None]
    failed: int
    memories: tuple[Mapping[int, Any], Mapping[int, Any]] | None
    interruption: BaseException | None

    @property
    def lengths(self) -> Array:
        """(k, 1) lengths of the steps [s]."""
        return self.times[:, -1:] - self.times[:, :1]

    @property
    def ends(self) -> dict[str, Array]:
        """Results at the end of each step, (k, ...) by name."""
        return {name: x[:, -1] for name, x in self.points.items()}


def stepper_of(segment: Segment) -> FusedStepper | None:
    """Return the stepper whose steps can be taken together; None if there is none."""
    stepper = segment.stepper
    whole = stepper.whole if isinstance(stepper, SubdividingStepper) else stepper
    if isinstance(stepper, SubdividingStepper) and isinstance(whole, PythonLawStepper):
        return None  # whose steps are not screened
    return whole if isinstance(whole, FusedStepper) and not whole.scheme.adaptive else None


def next_ends(at: RunState, most: int) -> tuple[Array, Array]:
    """Return the times at which the next steps end, up to the next event [s], and whether they begin with a jump."""
    settings, saved, now = at.segment.settings, at.checkpoint, at.now.t
    stop = slice(saved.stop, saved.stop + 2 * most + 1)
    times, jumps = settings.stops.times[stop], settings.stops.jumps[stop]
    following = np.diff(np.concatenate([[now], times])) > 0.0
    apart = times < min((event.t for event in settings.events[saved.event :]), default=np.inf)
    good = following & apart & ~(jumps & np.concatenate([[False], jumps[:-1]]))
    if saved.resolution.off > 0.0:  # what was noticed is reported by the run's last step
        good &= times < settings.end
    count = len(good) if good.all() else int(np.argmin(good))
    ending = np.flatnonzero(~jumps[:count])[:most]
    return times[ending], (ending > 0) & jumps[ending - 1]


def steps_together(at: RunState, stepper: FusedStepper, ends: Array, jumps: Array) -> StepsTogether:
    """Return steps to the given ends, with their margins.

    Args:
        at: the run.
        stepper: the stepper.
        ends: (k,) times at which they end [s].
        jumps: (k,) whether they begin with a jump.
    """
    segment, now = at.segment, at.now
    stops = segment.settings.stops.times[at.checkpoint.stop :]
    begins = np.concatenate([[now.t], ends[:-1]])
    begins[jumps] = stops[np.searchsorted(stops, ends[jumps]) - 1]
    parts = np.array(evaluation_parts(segment.scheme.c.tolist()) if len(segment.signals.limited) else [])
    inside = begins[:, None] + parts * (ends - begins)[:, None]
    times = np.concatenate([begins[:, None], inside, ends[:, None]], axis=1)
    held: list[HeldTorques | None] = []
    interrupted: list[BaseException] = []
    remember = None if at.checkpoint.held is None else _sampling(at, begins, jumps, held, interrupted)
    points, after_jumps, taken, again, memories, interruption = stepper.take(now, times, jumps, remember)
    interruption = interrupted[0] if interrupted else interruption
    starts, first = {}, stepper.carried_at(now)
    for name in [name for name in OF_STARTS if name in first]:
        starts[name] = np.concatenate([first[name], points[name][:-1, -1]])
        starts[name][jumps] = after_jumps[name][jumps, 0]
    margins = segment.signals.of_arrays(points).swapaxes(0, 1)
    here = np.concatenate([at.margins[-1:], margins[-1, :-1]])
    tail = at.checkpoint.tail if at.previous is not None else np.full(len(segment.signals), -np.inf)
    before = np.concatenate([tail[None], margins[-2, :-1] if len(parts) else here[:-1]])
    if jumps.any():
        here[jumps], before[jumps] = segment.signals.of_arrays(after_jumps)[jumps, 0], -np.inf
    margins = np.concatenate([before[None], here[None], margins])
    failed = taken if remember is None else min(taken, len(held))
    return StepsTogether(
        times, jumps, points, starts, after_jumps, margins, again, held, failed, memories, interruption
    )


def margins_at(at: RunState, steps: StepsTogether, near: Sequence[int], times: Sequence[float]) -> Array:
    """Return the margins at further times, (times, signals); not a number where a step needs a closer look.

    Args:
        at: the run.
        steps: the steps.
        near: for each time the number of its step, or of the one after it.
        times: the times [s].
    """
    if not times:
        return np.zeros((0, len(at.segment.signals)))
    of_step = [k - int(t < steps.times[k, 0]) for k, t in zip(near, times, strict=True)]
    x = steps.again(of_step, [t - steps.times[k, 0] for k, t in zip(of_step, times, strict=True)])
    margins = at.segment.signals.of_arrays(x)
    margins[needs_a_look(at.segment, x)] = np.nan
    return margins


def needs_a_look(segment: Segment, x: Mapping[str, Array]) -> Array:
    """Return whether a step has failed, has to be subdivided, or leads to forces that the reference has to choose."""
    found = x["code"] != 0.0
    if isinstance(segment.stepper, SubdividingStepper):
        found |= x["gaps"][..., 0] > segment.stepper.limit
    return found | segment.signals.undecided(x)


def _sampling(
    at: RunState,
    begins: Array,
    jumps: Array,
    held: list[HeldTorques | None],
    interrupted: list[BaseException],
) -> Callable[[int, Systems], Array | None]:
    """Return the function that samples the controller before each step, and adds its state to `held` until it fails."""
    segment, last = at.segment, [at.checkpoint.held, at.now.memory]

    def remember(k: int, ends: Systems) -> Array | None:
        if len(held) < k or interrupted:
            return None  # it has failed
        before, acting = last
        state = at.now.state if k == 0 else state_of(ends, (k - 1, -1))
        try:
            last[:] = segment.sampled(float(begins[k]), state, before, acting)
        except Exception:  # raised again where the step is taken by itself
            return None
        except KeyboardInterrupt as cause:
            interrupted.append(cause)
            return None
        held.append(last[0])
        return last[1] if jumps[k] else None

    return remember
