"""Fixed steps in which nothing happens, taken one after another by machine code, and checked and recorded together.

A step may need more than its result: a margin becomes negative or has a minimum inside it, the constraint loses rank,
the velocities change too much for the step, or it fails. Such a step is taken by `run_step.stepped`. Here only these
are recognised, for many steps at once, with the same bounds and searches. What is returned is the same, bit for bit,
however many steps are taken together.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.closed.chain_motion import chain_at_rest
from holdfast.dynamics.constraint import coordinate_sizes
from holdfast.dynamics.near_singular import chain_strength
from holdfast.questions.arrays import state_of
from holdfast.simulation.adaptive_parts import agreement, disagreement
from holdfast.simulation.checkpoint import Checkpoint, Origin
from holdfast.simulation.instant import Instant
from holdfast.simulation.margins import ViolationTracker
from holdfast.simulation.resolution import leap, least_difference
from holdfast.simulation.rollout.fused_stepper import FusedStepper
from holdfast.simulation.rollout.kernel import Systems
from holdfast.simulation.rollout.python_law_stepper import PythonLawStepper
from holdfast.simulation.rollout.rows import TWISTS, gaps_of, velocities_in
from holdfast.simulation.run_step import LARGEST_RATE, RunState
from holdfast.simulation.sample import Samples, arrays_of, lowest_of, recorded
from holdfast.simulation.segment import Segment, suited
from holdfast.simulation.singular_configuration import (
    SHORTENED_WITHIN,
    changes_much,
    configurations_passed,
    may_lose,
    time_left,
)
from holdfast.simulation.stability import cell
from holdfast.simulation.stepper import SubdividingStepper
from holdfast.simulation.trajectory import Trajectory
from holdfast.simulation.verification import evaluation_parts, in_doubt
from holdfast.simulation.zero_order_hold import HeldTorques
from holdfast.spatial.scalar import Array

SIZE_RATIO = 0.5  # bound on the ratio of two sizes of a chain (`coordinate_sizes`) in neighbouring configurations


def uneventful_steps(at: RunState, most: int) -> Stretch | None:
    """Return the next steps in which nothing happens; None if there are none.

    Args:
        at: the run.
        most: the largest number of steps to take, at most `MOST_TOGETHER`.
    """
    stepper = _stepper(at.segment)
    if stepper is None or at.ended is not None or at.violated() is not None:
        return None
    ends, jumps = _ends(at, most)
    if not len(ends):
        return None
    steps = _taken(at, stepper, ends, jumps)
    count = int(np.argmax(found)) if (found := _eventful(at, steps)).any() else len(ends)
    return _accepted(at, stepper, steps, count) if count else None


class Stretch(NamedTuple):
    """A part of a run in which nothing has happened.

    Attributes:
        samples: its samples: the end of each step, and before it its start if that follows a jump.
        end: the run after the last.
        checkpoint: returns the checkpoint after a sample, counted from 0.
        whole: whether all steps that were tried belong to it.
    """

    samples: Trajectory
    end: RunState
    checkpoint: Callable[[int], Checkpoint]
    whole: bool


class _Steps(NamedTuple):
    """Steps that have been taken, before it is known in which of them nothing happens.

    Attributes:
        times: (k, points + 1) the start of each step, and the points at which it was evaluated, the last its end [s].
        jumps: (k,) whether torques or inputs jump at the start.
        points: results at the points, (k, points, ...) by name.
        starts: results at the start, (k, ...) by name.
        after_jumps: results at those starts that follow a jump, (k, 1, ...) by name; those of other steps mean nothing.
        margins: (k, points + 2, signals) margins before the start, at it, and at the points; minus infinity before a
            start without an evaluation that belongs to the same smooth stretch.
        held: the state of a sampled controller during each step.
        failed: number of the step before which the controller raised an error; k if it did not.
        memories: as in `Taken`.
    """

    times: Array
    jumps: Array
    points: Mapping[str, Array]
    starts: Mapping[str, Array]
    after_jumps: Mapping[str, Array]
    margins: Array
    held: Sequence[HeldTorques | None]
    failed: int
    memories: tuple[Sequence[Any], Sequence[Any]] | None

    @property
    def lengths(self) -> Array:
        """(k, 1) lengths of the steps [s]."""
        return self.times[:, -1:] - self.times[:, :1]

    @property
    def ends(self) -> dict[str, Array]:
        """Results at the end of each step, (k, ...) by name."""
        return {name: x[:, -1] for name, x in self.points.items()}


def _stepper(segment: Segment) -> FusedStepper | None:
    """Return the stepper whose steps can be taken together; None if there is none."""
    stepper = segment.stepper
    whole = stepper.whole if isinstance(stepper, SubdividingStepper) else stepper
    if isinstance(stepper, SubdividingStepper) and isinstance(whole, PythonLawStepper):
        return None  # whose steps are not screened
    return whole if isinstance(whole, FusedStepper) else None


def _ends(at: RunState, most: int) -> tuple[Array, Array]:
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


def _taken(at: RunState, stepper: FusedStepper, ends: Array, jumps: Array) -> _Steps:
    """Return steps to the given ends, with their margins."""
    segment, now = at.segment, at.now
    stops = segment.settings.stops.times[at.checkpoint.stop :]
    begins = np.concatenate([[now.t], ends[:-1]])
    begins[jumps] = stops[np.searchsorted(stops, ends[jumps]) - 1]
    parts = np.array(evaluation_parts(segment.scheme.c.tolist()) if len(segment.signals.limited) else [])
    inside = begins[:, None] + parts * (ends - begins)[:, None]
    times = np.concatenate([begins[:, None], inside, ends[:, None]], axis=1)
    held: list[HeldTorques | None] = []
    remember = None if at.checkpoint.held is None else _sampling(at, begins, jumps, held)
    points, after_jumps, taken, memories = stepper.take(now, times, jumps, remember)
    start = stepper.start_of(now)
    starts = {}
    for name, x in {**start, **arrays_of(now)}.items():
        starts[name] = np.concatenate([x, points[name][:-1, -1]])
        starts[name][jumps] = after_jumps[name][jumps, 0]
    margins = segment.signals.of_arrays(points)
    here = np.concatenate([at.margins[-1:], margins[:-1, -1]])
    tail = at.checkpoint.tail if at.previous is not None else np.full(len(segment.signals), -np.inf)
    before = np.concatenate([tail[None], margins[:-1, -2] if len(parts) else here[:-1]])
    here[jumps], before[jumps] = segment.signals.of_arrays(after_jumps)[jumps, 0], -np.inf
    margins = np.concatenate([before[:, None], here[:, None], margins], axis=1)
    failed = taken if remember is None else len(held)
    return _Steps(times, jumps, points, starts, after_jumps, margins, held, failed, memories)


def _sampling(
    at: RunState, begins: Array, jumps: Array, held: list[HeldTorques | None]
) -> Callable[[int, Systems], Array | None]:
    """Return the function that samples the controller before each step, and adds its state to `held` until it fails."""
    segment, last = at.segment, [at.checkpoint.held, at.now.memory]

    def remember(k: int, ends: Systems) -> Array | None:
        if len(held) < k:
            return None  # it has failed
        before, acting = last
        state = at.now.state if k == 0 else state_of(ends, (k - 1, -1))
        try:
            last[:] = segment.sampled(float(begins[k]), state, before, acting)
        except Exception:  # raised again where the step is taken by itself
            return None
        held.append(last[0])
        return last[1] if jumps[k] else None

    return remember


def _eventful(at: RunState, steps: _Steps) -> Array:
    """Return in which of the steps something may happen, (k,); results after the first of these mean nothing."""
    ends = steps.ends
    found = (steps.points["code"] != 0.0).any(axis=1) | ~(np.abs(ends["qd"]).max(axis=-1, initial=0.0) < LARGEST_RATE)
    found |= (steps.after_jumps["code"][:, 0] != 0.0) & steps.jumps
    found[steps.failed :] = True
    if isinstance(at.segment.stepper, SubdividingStepper):
        found |= (steps.points["gaps"][..., 0] > at.segment.stepper.limit).any(axis=1)
    found |= _near_limits(at, steps) | _unresolved(at, steps)
    singular, long = _near_singular(at, steps)
    cells = (cell(steps.starts["q"]) != cell(ends["q"])).any(axis=-1)
    for k in np.flatnonzero(singular | cells).tolist():  # a closer look at each
        if found[:k].any():
            break
        found[k] |= (cells[k] and _becomes_stiff(at, steps, k)) or (singular[k] and _loses_rank(at, steps, k))
    long[np.logical_or.accumulate(found)] = False  # nobody asks
    return found | _too_long(at, steps, long)


def _becomes_stiff(at: RunState, steps: _Steps, k: int) -> bool:
    """Return whether steps of this kind are too long for the springs and dampers after a step."""
    _, news = suited(at.segment, float(steps.times[k, -1]), state_of(steps.ends, k))
    return bool(news)


def _loses_rank(at: RunState, steps: _Steps, k: int) -> bool:
    """Return whether a step passes a singular configuration, or is near one ahead."""
    segment, stepper = at.segment, _stepper(at.segment)
    assert stepper is not None
    now, memory = at.now, at.now.memory
    if steps.jumps[k]:
        now = stepper.instant(
            {name: x[:, 0] for name, x in steps.after_jumps.items()}, k, float(steps.times[k, 0]), memory
        )
    elif k > 0:
        now = stepper.instant(steps.ends, k - 1, float(steps.times[k, 0]), memory)
    later = stepper.instant(steps.ends, k, float(steps.times[k, -1]), memory)
    if segment.settings.policy.on_singular == "continue":
        step = segment.settings.longest_step
        left = time_left(segment, now, step)
        if left is not None and left <= SHORTENED_WITHIN * step:
            return True
    return next(configurations_passed(segment, now, later), None) is not None


def _near_limits(at: RunState, steps: _Steps) -> Array:
    """Return in which steps a margin is or may be negative, or has a minimum to refine, (k,)."""
    signals = at.segment.signals
    m = steps.margins[..., signals.limited]
    if not m.size:
        return np.zeros(len(m), dtype=bool)
    if signals.grasps_limited:  # forces that are not unique are chosen by the reference
        unique = steps.points["rank"] == at.segment.environment.chain.constraint_row_count
        found = ~unique.all(axis=1)
    else:
        found = np.zeros(len(m), dtype=bool)
    tracker = at.checkpoint.tracker
    return found | in_doubt(m, np.isfinite(tracker.since[signals.limited]), tracker.lowest[signals.limited])


def _unresolved(at: RunState, steps: _Steps) -> Array:
    """Return in which steps the velocities change otherwise than by the mean of the accelerations, (k,)."""
    v0, v1, a0, a1 = (of(x) for of in (velocities_in, _accelerations) for x in (steps.starts, steps.ends))
    jump = leap(steps.lengths, v0, v1, a0, a1)
    return ~(jump <= least_difference(_largest(at, steps)))


def _largest(at: RunState, steps: _Steps) -> Array:
    """Return the largest velocities of the run up to the end of each step, (k,) [rad/s or m/s]."""
    both = np.maximum(*(np.abs(velocities_in(x)).max(axis=-1) for x in (steps.starts, steps.ends)))
    return np.maximum(np.maximum.accumulate(both), at.checkpoint.resolution.largest)


def _accelerations(x: Mapping[str, Array]) -> Array:
    names = ("qdd", "object_acceleration", "floating_acceleration")
    return np.concatenate([x[name] for name in names if name in x], axis=-1)


def _near_singular(at: RunState, steps: _Steps) -> tuple[Array, Array]:
    """Return in which steps the constraint may lose rank, and changes so much that the step may be too long, (k,)."""
    segment, h = at.segment, steps.lengths[:, 0]
    x, y = steps.starts, steps.ends
    chain, goes_on = segment.environment.chain, segment.settings.policy.on_singular == "continue"
    if segment.generic_rank <= chain.contact_freedom_count:
        return np.zeros(len(h), dtype=bool), np.zeros(len(h), dtype=bool)
    here, later = chain_strength(x["condition"]), chain_strength(y["condition"])
    first = here[0] if at.previous is None else chain_strength(np.array(at.previous.result.condition))
    before = np.where(steps.jumps, here, np.concatenate([[first], here[:-1]]))
    sizes = np.ones(chain.joint_count)
    if not all(joint.turns for joint in chain.all_joints):
        sizes = SIZE_RATIO * coordinate_sizes(chain_at_rest(at.now.chain, at.now.state))[: chain.joint_count]
        sizes[[joint.turns for joint in chain.all_joints]] = 1.0
    turning = np.maximum(*(_turning(z) for z in (x, y)))
    moved = np.maximum((np.abs(y["q"] - x["q"]) / sizes).max(axis=1, initial=0.0), h * turning)
    found = np.asarray(may_lose(here + later, moved))
    if goes_on:  # whether a configuration lies ahead
        ahead = 2.0 * segment.settings.longest_step
        by_joints = np.abs(ahead * x["qd"] + 0.5 * ahead**2 * x["qdd"]) / sizes
        found |= may_lose(here, np.maximum(by_joints.max(axis=1, initial=0.0), ahead * turning))
    return found, changes_much(before, here, later)


def _too_long(at: RunState, steps: _Steps, doubtful: Array) -> Array:
    """Return which of the doubtful steps do not agree with their halves, (k,); see `adaptive_parts`."""
    found, stepper, k = doubtful.copy(), _stepper(at.segment), np.flatnonzero(doubtful)
    if stepper is None or isinstance(stepper, PythonLawStepper) or not len(k):
        return found
    start = {name: x[k] for name, x in steps.starts.items()}
    first, second = stepper.in_halves(start, steps.times[k][:, [0, -1]])
    whole, fine, before = (velocities_in(x) for x in ({n: x[k] for n, x in steps.ends.items()}, second, start))
    agree = disagreement(whole, fine, before) <= agreement(stepper.scheme)
    for half in (first, second):
        agree &= half["code"] == 0.0
        if isinstance(at.segment.stepper, SubdividingStepper):
            agree &= half["gaps"][:, 0] <= at.segment.stepper.limit
    found[k] = ~agree
    return found


def _turning(x: Mapping[str, Array]) -> Array:
    """Return the fastest rotation of the object and of a floating base, (k,), in each direction [rad/s]."""
    rates = [np.abs(x[name][:, :3]).max(axis=1) for name in TWISTS if name in x]
    return np.max(rates, axis=0)


def _accepted(at: RunState, stepper: FusedStepper, steps: _Steps, count: int) -> Stretch:
    """Return the first steps as a part of the run."""
    segment, saved, memory = at.segment, at.checkpoint, at.now.memory
    jumps = steps.jumps[:count]
    # the samples in order: number of the step, and whether a sample is the start after a jump
    step, jumped = np.repeat(np.arange(count), 1 + jumps), np.zeros(count + jumps.sum(), dtype=bool)
    jumped[np.flatnonzero(jumps) + np.arange(jumps.sum())] = True
    x = {name: array[step, -1] for name, array in steps.points.items()}
    for name, array in steps.after_jumps.items():
        x[name][jumped] = array[step[jumped], 0]
    x["gaps"][jumped] = 0.0
    margins, times = steps.margins[step, 1:], steps.times[step]
    margins[jumped], times[jumped] = margins[jumped, :1], times[jumped, :1]
    t = times[:, -1]
    work = np.cumsum(np.concatenate([saved.sums.work[None], x["work"]]), axis=0)[1:]
    returned: Sequence[Any] = [memory] * len(t)
    passed = x.get("before", returned)
    if steps.memories is not None:
        returned = [steps.memories[0 if jump else 1][k] for k, jump in zip(step.tolist(), jumped.tolist(), strict=True)]
        passed = [memory, *returned[:-1]]

    @cache
    def instant(k: int) -> Instant:
        return stepper.instant(x, k, float(t[k]), returned[k])

    of_grasps = margins[:, -1, : len(segment.environment.chain.arms)]
    samples = Samples(t, x, (of_grasps, of_grasps, of_grasps), x["gaps"], work, *lowest_of(times, margins))
    run = recorded(segment.environment, segment.stepper.accounts, samples, saved.sums, segment.settings.recording.names)
    followed, largest = _followed(saved.tracker, samples), _largest(at, steps)

    def origin(k: int) -> Origin:
        return saved.now if k < 0 else Origin(float(t[k]), state_of(x, k), passed[k])

    def after(k: int) -> Checkpoint:
        if jumped[k]:
            before: dict[str, Any] = {"previous": None, "tail_time": float(t[k]), "tail": margins[k, :0, 0]}
        else:
            before = {"previous": origin(k - 1), "tail_time": float(times[k, -2]), "tail": margins[k, -2]}
        of_step = step[k] - jumped[k]
        resolution = saved.resolution
        if of_step >= 0:
            resolution = resolution._replace(largest=float(largest[of_step]), in_a_row=0)
        return replace(
            saved,
            now=origin(k),
            stop=saved.stop + k + 1,
            sums=saved.sums._replace(work=work[k]),
            tracker=followed(k),
            resolution=resolution,
            held=steps.held[step[k]] if steps.held else None,
            **before,
        )

    last = len(t) - 1
    earlier = at.now if last == 0 else instant(last - 1)
    end = RunState(segment, after(last), instant(last), earlier, gaps_of(x, last), times[last], margins[last])
    return Stretch(run, end, after, count == len(steps.times))


def _followed(before: ViolationTracker, samples: Samples) -> Callable[[int], ViolationTracker]:
    """Return the function that gives the tracker after a sample; violations neither begin nor end."""
    beyond = np.isfinite(before.since)
    lowest = np.minimum.accumulate(np.concatenate([before.lowest[None], samples.lowest]))
    depth = np.minimum.accumulate(np.concatenate([before.depth[None], np.where(beyond, samples.lowest, np.inf)]))
    deeper = np.concatenate([beyond[None] & False, depth[1:] < depth[:-1]])
    last = np.maximum.accumulate(np.where(deeper, np.arange(len(deeper))[:, None], 0), axis=0)
    times = np.concatenate([before.depth_time[None], samples.lowest_time])
    when = np.take_along_axis(times, last, axis=0)

    def after(k: int) -> ViolationTracker:
        return replace(before, lowest=lowest[k + 1], depth=depth[k + 1], depth_time=when[k + 1])

    return after
