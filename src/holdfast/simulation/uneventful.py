"""Fixed steps in which nothing happens, taken one after another by machine code, and checked and recorded together.

A step may need more than its result: a margin becomes negative inside it, the constraint loses rank, the velocities
change too much for the step, or it fails. Such a step is taken by `run_step.stepped`. Here only these are recognised,
for many steps at once, with the same bounds and searches. What is returned is the same, bit for bit, however many steps
are taken together.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.closed.chain_motion import chain_at_rest
from holdfast.dynamics.constraint import SMALLEST_LENGTH, coordinate_sizes
from holdfast.dynamics.contact.fixed_modes import STOPS_SOON
from holdfast.dynamics.near_singular import chain_strength
from holdfast.questions.arrays import state_of
from holdfast.simulation.adaptive_parts import agreement, disagreement
from holdfast.simulation.bracket import search_lowest, together
from holdfast.simulation.checkpoint import Checkpoint, Origin
from holdfast.simulation.instant import Instant
from holdfast.simulation.margins import ViolationTracker
from holdfast.simulation.resolution import leap, least_difference
from holdfast.simulation.rollout.fused_stepper import FusedStepper
from holdfast.simulation.rollout.python_law_stepper import PythonLawStepper
from holdfast.simulation.rollout.rows import ACCELERATIONS, TWISTS, gaps_of, velocities_in
from holdfast.simulation.run_step import LARGEST_RATE, TURNING, RunState
from holdfast.simulation.sample import Samples, lowest_of
from holdfast.simulation.segment import suited
from holdfast.simulation.singular_configuration import (
    SHORTENED_WITHIN,
    changes_much,
    configurations_passed,
    may_lose,
    time_left,
)
from holdfast.simulation.stability import cell
from holdfast.simulation.stepper import SubdividingStepper
from holdfast.simulation.steps_together import (
    StepsTogether,
    margins_at,
    needs_a_look,
    next_ends,
    stepper_of,
    steps_together,
)
from holdfast.simulation.trajectory import Trajectory
from holdfast.simulation.verification import TIME_OF_MINIMUM, changes, in_doubt, may_be_negative, minima
from holdfast.spatial.scalar import Array

SIZE_RATIO = 0.5  # bound on the ratio of two sizes of a chain (`coordinate_sizes`) in neighbouring configurations
Curve = tuple[Array, Array]  # times (k,) within a step in order [s], the last its end, and the margins (k, signals)


def uneventful_steps(at: RunState, most: int) -> Stretch | None:
    """Return the next steps in which nothing happens; None if there are none.

    Args:
        at: the run.
        most: the largest number of steps to take, at most `MOST_TOGETHER`.
    """
    stepper = stepper_of(at.segment)
    if stepper is None or at.ended is not None or at.violated() is not None or not stepper.follows(at.now):
        return None
    ends, jumps = next_ends(at, most)
    if not len(ends):
        return None
    steps = steps_together(at, stepper, ends, jumps)
    count = int(np.argmax(found)) if (found := _eventful(at, steps)).any() else len(ends)
    refined, count = _refined(at, steps, count)
    if not count and steps.interruption is not None:
        raise steps.interruption
    return _accepted(at, stepper, steps, refined, count) if count else None


class Stretch(NamedTuple):
    """A part of a run in which nothing has happened.

    Attributes:
        samples: its samples: the end of each step, and before it its start if that follows a jump.
        end: the run after the last.
        checkpoint: returns the checkpoint after a sample, counted from 0.
        steps: number of its steps.
        whole: whether all steps that were tried belong to it.
        interruption: what interrupted the controller ahead, such as Ctrl-C.
    """

    samples: Trajectory
    end: RunState
    checkpoint: Callable[[int], Checkpoint]
    steps: int
    whole: bool
    interruption: BaseException | None


def _eventful(at: RunState, steps: StepsTogether) -> Array:
    """Return in which of the steps something may happen, (k,); results after the first of these mean nothing."""
    segment, ends = at.segment, steps.ends
    found = needs_a_look(segment, steps.points).any(axis=1)
    found |= ~(np.abs(ends["qd"]).max(axis=-1, initial=0.0) < LARGEST_RATE)
    found |= (steps.after_jumps["code"][:, 0] != 0.0) & steps.jumps
    found[steps.failed :] = True
    found |= _turns(steps)
    found |= _near_limits(at, steps) | _unresolved(at, steps)
    singular, long = _near_singular(at, steps)
    cells = (cell(steps.starts["q"]) != cell(ends["q"])).any(axis=-1)
    for k in np.flatnonzero(singular | cells).tolist():  # a closer look at each
        if found[:k].any():
            break
        found[k] |= (cells[k] and _becomes_stiff(at, steps, k)) or (singular[k] and _loses_rank(at, steps, k))
    long[np.logical_or.accumulate(found)] = False  # nobody asks
    return found | _too_long(at, steps, long)


def _turns(steps: StepsTogether) -> Array:
    """Return in which steps friction may turn a slip too far, or a slip or a jump changes what contacts do, (k,).

    A slip that stops soon keeps its direction; see `Touch.modes_within`.
    """
    starts, t = steps.starts, steps.times
    if "touch_turning" not in starts:
        return np.zeros(len(t), dtype=bool)
    stops = (starts["touch_stops"] < STOPS_SOON * (t[:, -1] - t[:, 0])[:, None]).any(axis=-1)
    return steps.jumps | stops | (t[:, 0] + TURNING * starts["touch_turning"] < t[:, -1])


def _becomes_stiff(at: RunState, steps: StepsTogether, k: int) -> bool:
    """Return whether steps of this kind are too long for the springs and dampers after a step."""
    segment, news = suited(at.segment, float(steps.times[k, -1]), state_of(steps.ends, k))
    return segment is not at.segment or bool(news)


def _loses_rank(at: RunState, steps: StepsTogether, k: int) -> bool:
    """Return whether a step passes a singular configuration, or is near one ahead."""
    segment, stepper = at.segment, stepper_of(at.segment)
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


def _near_limits(at: RunState, steps: StepsTogether) -> Array:
    """Return in which steps a margin is or may be negative, (k,)."""
    if not len(at.segment.signals.limited):
        return np.zeros(len(steps.times), dtype=bool)
    return in_doubt(steps.margins[1:], at.checkpoint.tracker.beyond)


def _refined(at: RunState, steps: StepsTogether, count: int) -> tuple[dict[int, Curve], int]:
    """Return the margins in the first steps that have a minimum to refine, and how many steps then remain uneventful.

    Args:
        at: the run.
        steps: the steps.
        count: number of steps in which nothing happens apart from such minima.
    """
    m, lowest = steps.margins[:, :count], at.checkpoint.tracker.lowest
    if isinstance(stepper_of(at.segment), PythonLawStepper):  # whose margins inside steps do not decide
        count = min([count, *may_be_negative(m)[1].tolist()])
        m = m[:, :count]
    least = np.minimum.accumulate(np.concatenate([lowest[None], m[1:].min(axis=0)]))
    brackets = list(zip(*(places.tolist() for places in minima(m, least[1:])), strict=True))
    if any(row == k == 0 for row, k, _ in brackets):  # it begins in a step before these
        return {}, 0
    searched = _searched(at, steps, brackets)
    found: dict[int, Curve] = {}
    for k in sorted({k for _, k, _ in brackets}):
        # what was refined before may have been lower than this
        deep = set(zip(*(places.tolist() for places in minima(m[:, k], np.minimum(lowest, least[k + 1]))), strict=True))
        known = dict(zip(steps.times[k].tolist(), m[1:, k], strict=True))
        for (row, step, signal), margins in zip(brackets, searched, strict=True):
            known |= margins if step == k and (row, signal) in deep else {}
        times = np.array(sorted(known))
        margins = np.array([known[t] for t in times.tolist()])
        if changes(margins, at.checkpoint.tracker.beyond):
            return found, k
        found[k], lowest = (times, margins), np.minimum(lowest, margins.min(axis=0))
    return found, count


def _searched(at: RunState, steps: StepsTogether, brackets: Sequence[tuple[int, int, int]]) -> list[dict[float, Array]]:
    """Return the margins that the search for the minimum in each bracket has evaluated, by time.

    Args:
        at: the run.
        steps: the steps.
        brackets: number of the first of three evaluations, of the step, and of the signal.
    """
    found: list[dict[float, Array]] = [{} for _ in brackets]
    known, searches = [], []
    for row, k, signal in brackets:
        a, b, c = [*steps.times[k - 1, -2:-1].tolist(), *steps.times[k].tolist()][row : row + 3]
        known.append(dict(zip((a, b, c), steps.margins[row : row + 3, k, signal].tolist(), strict=True)))
        searches.append(search_lowest(a, b, c, TIME_OF_MINIMUM * float(steps.lengths[k, 0])))

    def values(times: Mapping[int, float]) -> list[float]:
        new = [i for i, t in times.items() if t not in known[i]]
        reached = margins_at(at, steps, [brackets[i][1] for i in new], [times[i] for i in new])
        for i, margins in zip(new, reached, strict=True):
            found[i][times[i]], known[i][times[i]] = margins, float(margins[brackets[i][2]])
        return [known[i][t] for i, t in times.items()]

    together(searches, values)
    return found


def _unresolved(at: RunState, steps: StepsTogether) -> Array:
    """Return in which steps the velocities change otherwise than by the mean of the accelerations, (k,)."""
    v0, v1, a0, a1 = (of(x) for of in (velocities_in, _accelerations) for x in (steps.starts, steps.ends))
    jump = leap(steps.lengths, v0, v1, a0, a1)
    return ~(jump <= least_difference(_largest(at, steps)))


def _largest(at: RunState, steps: StepsTogether) -> Array:
    """Return the largest velocities of the run up to the end of each step, (k,) [rad/s or m/s]."""
    both = np.maximum(*(np.abs(velocities_in(x)).max(axis=-1) for x in (steps.starts, steps.ends)))
    return np.maximum(np.maximum.accumulate(both), at.checkpoint.resolution.largest)


def _accelerations(x: Mapping[str, Array]) -> Array:
    return np.concatenate([x[name].reshape(len(x["qdd"]), -1) for name in ACCELERATIONS if name in x], axis=-1)


def _near_singular(at: RunState, steps: StepsTogether) -> tuple[Array, Array]:
    """Return in which steps the constraint may lose rank, and changes so much that the step may be too long, (k,)."""
    segment, h = at.segment, steps.lengths[:, 0]
    x, y = steps.starts, steps.ends
    chain, goes_on = segment.environment.chain, segment.settings.policy.on_singular == "continue"
    if not segment.finds_singular or segment.generic_rank <= chain.contact_freedom_count:
        return np.zeros(len(h), dtype=bool), np.zeros(len(h), dtype=bool)
    here, later = chain_strength(x["condition"]), chain_strength(y["condition"])
    first = here[0] if at.previous is None else chain_strength(np.array(at.previous.result.condition))
    before = np.where(steps.jumps, here, np.concatenate([[first], here[:-1]]))
    turning = np.maximum(*(_turning(z) for z in (x, y)))
    ahead = 2.0 * segment.settings.longest_step if goes_on else 0.0  # where a configuration may lie
    by_joints = np.abs(y["q"] - x["q"]), np.abs(ahead * x["qd"] + 0.5 * ahead**2 * x["qdd"])

    def found(length: float) -> Array:
        sizes = np.array([1.0 if joint.turns else length for joint in chain.all_joints])
        moved, further = ((moves / sizes).max(axis=1, initial=0.0) for moves in by_joints)
        lost = np.asarray(may_lose(here + later, np.maximum(moved, h * turning)))
        return lost | may_lose(here, np.maximum(further, ahead * turning)) if goes_on else lost

    shortest = max([SMALLEST_LENGTH, *(float(np.linalg.norm(grasp.frame.p)) for grasp in chain.grasps.values())])
    singular = found(shortest)
    if singular.any() and not all(joint.turns for joint in chain.all_joints):  # the unit of length may be longer
        unit = coordinate_sizes(chain_at_rest(at.now.chain, at.now.state))[chain.joint_count + 3]
        singular = found(max(shortest, SIZE_RATIO * float(unit)))
    return singular, changes_much(before, here, later)


def _too_long(at: RunState, steps: StepsTogether, doubtful: Array) -> Array:
    """Return which of the doubtful steps do not agree with their halves, (k,); see `adaptive_parts`."""
    found, stepper, k = doubtful.copy(), stepper_of(at.segment), np.flatnonzero(doubtful)
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


def _accepted(
    at: RunState, stepper: FusedStepper, steps: StepsTogether, refined: Mapping[int, Curve], count: int
) -> Stretch:
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
    x |= stepper.of_samples(x)
    margins, times = steps.margins[1:, step], steps.times[step]
    margins[:, jumped], times[jumped] = margins[:1, jumped], times[jumped, :1]
    t = times[:, -1]
    work = np.cumsum(np.concatenate([saved.sums.work[None], x["work"]]), axis=0)[1:]
    returned: Sequence[Any] = [memory] * len(t)
    passed = x.get("before", returned)
    if steps.memories is not None:
        returned = [steps.memories[0 if jump else 1][k] for k, jump in zip(step.tolist(), jumped.tolist(), strict=True)]
        passed = [memory, *returned[:-1]] if saved.held is None else returned  # a hold returns what it is given

    @cache
    def instant(k: int) -> Instant:
        return stepper.instant(x, k, float(t[k]), returned[k])

    of_grasps = margins[-1, :, : segment.signals.quantities.count("grasp")]
    lowest, when = lowest_of(times, margins.swapaxes(0, 1))
    for k, curve in refined.items():
        sample = k + int(jumps[: k + 1].sum())
        lowest[sample], when[sample] = lowest_of(*curve)
    samples = Samples(t, x, (of_grasps, of_grasps, of_grasps), x["gaps"], work, lowest, when)
    run = segment.recorded(samples, saved.sums)
    followed, largest = _followed(saved.tracker, samples), _largest(at, steps)

    def origin(k: int) -> Origin:
        return saved.now if k < 0 else Origin(float(t[k]), state_of(x, k), passed[k])

    def after(k: int) -> Checkpoint:
        if jumped[k]:
            before: dict[str, Any] = {"previous": None, "tail_time": float(t[k]), "tail": margins[:0, k, 0]}
        else:
            before = {"previous": origin(k - 1), "tail_time": float(times[k, -2]), "tail": margins[-2, k]}
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
            contacts=stepper.modes_before(steps.starts, int(step[k]), saved.contacts),
            **before,
        )

    last = len(t) - 1
    earlier = at.now if last == 0 else instant(last - 1)
    end = RunState(segment, after(last), instant(last), earlier, gaps_of(x, last), times[last], margins[:, last])
    return Stretch(run, end, after, count, count == len(steps.times), steps.interruption)


def _followed(before: ViolationTracker, samples: Samples) -> Callable[[int], ViolationTracker]:
    """Return the function that gives the tracker after a sample; violations neither begin nor end."""
    beyond = before.beyond
    lowest = np.minimum.accumulate(np.concatenate([before.lowest[None], samples.lowest]))
    depth = np.minimum.accumulate(np.concatenate([before.depth[None], np.where(beyond, samples.lowest, np.inf)]))
    deeper = np.concatenate([beyond[None] & False, depth[1:] < depth[:-1]])
    last = np.maximum.accumulate(np.where(deeper, np.arange(len(deeper))[:, None], 0), axis=0)
    times = np.concatenate([before.depth_time[None], samples.lowest_time])
    when = np.take_along_axis(times, last, axis=0)

    def after(k: int) -> ViolationTracker:
        return replace(before, lowest=lowest[k + 1], depth=depth[k + 1], depth_time=when[k + 1])

    return after
