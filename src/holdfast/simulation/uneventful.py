"""Fixed steps in which nothing happens, taken one after another by machine code, and checked and recorded together.

A step may need more than its result: a margin becomes negative or has a minimum inside it, the constraint may lose
rank, the velocities change too much for the step, or it fails. Such a step is taken by `run_step.stepped`, which looks
closer. Here only these are recognised, for many steps at once, with the same bounds. What is returned is the same, bit
for bit, however many steps are taken together.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.chain_motion import chain_at_rest
from holdfast.dynamics.constraint import coordinate_sizes
from holdfast.dynamics.near_singular import chain_strength
from holdfast.forces.margins import margins_of_joints
from holdfast.simulation.checkpoint import IGNORED_RATE, OF_MOTION, Checkpoint, Origin
from holdfast.simulation.confirmation import leap
from holdfast.simulation.instant import Instant
from holdfast.simulation.margins import by_arm
from holdfast.simulation.rollout.fused_stepper import MOST_TOGETHER, FusedStepper
from holdfast.simulation.rollout.rows import gaps_of, state_of
from holdfast.simulation.run_step import LARGEST_RATE, RunState
from holdfast.simulation.sample import Samples, arrays_of, lowest_of, recorded
from holdfast.simulation.segment import Segment
from holdfast.simulation.singular_configuration import changes_much, may_lose
from holdfast.simulation.stability import cell
from holdfast.simulation.stepper import SubdividingStepper
from holdfast.simulation.trajectory import Trajectory
from holdfast.simulation.verification import evaluation_parts, may_cross, minima
from holdfast.spatial.scalar import Array

SHORTER = 0.5  # bound on the ratio of two sizes of a chain (`coordinate_sizes`) in neighbouring configurations


def uneventful_steps(at: RunState, most: int) -> Stretch | None:
    """Return the next steps in which nothing happens; None if there are none.

    Args:
        at: the run.
        most: the largest number of steps to take, at most `MOST_TOGETHER`.
    """
    stepper, ends = _stepper(at.segment), _ends(at)[:most]
    if stepper is None or not len(ends):
        return None
    steps = _taken(at, stepper, ends)
    count = int(np.argmax(found)) if (found := _eventful(at, steps)).any() else len(ends)
    return _accepted(at, stepper, steps, count) if count else None


class Stretch(NamedTuple):
    """Accepted steps in which nothing has happened.

    Attributes:
        samples: the sample at the end of each.
        end: the run after the last.
        checkpoint: returns the checkpoint after step k, counted from 0.
    """

    samples: Trajectory
    end: RunState
    checkpoint: Callable[[int], Checkpoint]


class _Steps(NamedTuple):
    """Steps that have been taken, before it is known in which of them nothing happens.

    Attributes:
        times: (k, points + 1) the start of each step, and the points at which it was evaluated, the last its end [s].
        points: results at the points, (k, points, ...) by name.
        nodes: results at the start of the first step and the ends of all, (k + 1, ...) by name.
        margins: (k, points + 2, signals) margins before the start of each step, at it, and at the points.
    """

    times: Array
    points: Mapping[str, Array]
    nodes: Mapping[str, Array]
    margins: Array

    @property
    def lengths(self) -> Array:
        """(k, 1) lengths of the steps [s]."""
        return self.times[:, -1:] - self.times[:, :1]


def _stepper(segment: Segment) -> FusedStepper | None:
    """Return the stepper whose steps can be taken together; None if there is none."""
    stepper = segment.stepper
    whole = stepper.whole if isinstance(stepper, SubdividingStepper) else stepper
    return whole if isinstance(whole, FusedStepper) and segment.settings.hold is None else None


def _ends(at: RunState) -> Array:
    """Return the times at which the next steps end, up to the next jump [s]; none if the run does not simply go on."""
    settings, saved = at.segment.settings, at.checkpoint
    if at.ended is not None or at.violated() is not None or np.isfinite(saved.tracker.since).any():
        return np.zeros(0)
    times, jumps = settings.stops
    ahead = times[saved.stop : saved.stop + MOST_TOGETHER + 1]
    jumping = np.flatnonzero(jumps[saved.stop : saved.stop + len(ahead)])
    ahead = ahead[: jumping[0]] if len(jumping) else ahead
    if saved.resolution.off > 0.0 and len(ahead) and ahead[-1] == times[-1]:
        ahead = ahead[:-1]  # what was noticed is reported by the run's last step
    return ahead if len(ahead) and ahead[0] > at.now.t else np.zeros(0)


def _taken(at: RunState, stepper: FusedStepper, ends: Array) -> _Steps:
    """Return steps to the given ends, with their margins."""
    segment, now = at.segment, at.now
    begins = np.concatenate([[now.t], ends[:-1]])
    parts = np.array(evaluation_parts(segment.scheme.c.tolist()) if len(segment.signals.limited) else [])
    inside = begins[:, None] + parts * (ends - begins)[:, None]
    times = np.concatenate([begins[:, None], inside, ends[:, None]], axis=1)
    points = stepper.take(now, begins, times[:, 1:] - times[:, :1])
    nodes = {name: np.concatenate([x, points[name][:, -1]]) for name, x in arrays_of(now).items()}
    margins = _margins(segment, points)
    starts = np.concatenate([at.margins[-1:], margins[:-1, -1]])
    tail = at.checkpoint.tail if at.previous is not None else np.full(len(segment.signals), -np.inf)
    before = np.concatenate([tail[None], margins[:-1, -2] if len(parts) else starts[:-1]])
    return _Steps(times, points, nodes, np.concatenate([before[:, None], starts[:, None], margins], axis=1))


def _margins(segment: Segment, points: Mapping[str, Array]) -> Array:
    """Return the margins at the points, (k, points, signals)."""
    chain, x = segment.environment.chain, points
    grasps = np.full((*x["q"].shape[:2], len(chain.arms)), np.inf)
    if segment.signals.grasps_limited:
        grasps = by_arm(chain, x["margin"])
    of_joints = margins_of_joints(segment.signals.joint_limits, x["q"], x["qd"], x["drive"])
    return np.concatenate([grasps, *of_joints], axis=-1)


def _eventful(at: RunState, steps: _Steps) -> Array:
    """Return in which of the steps something may happen, (k,); results after the first of these mean nothing."""
    found = (steps.points["code"] != 0.0).any(axis=1) | ~(np.abs(steps.nodes["qd"][1:]).max(axis=-1) < LARGEST_RATE)
    if isinstance(at.segment.stepper, SubdividingStepper):
        found |= (steps.points["gaps"][..., 0] > at.segment.stepper.limit).any(axis=1)
    found |= (cell(steps.nodes["q"][:-1]) != cell(steps.nodes["q"][1:])).any(axis=-1)
    return found | _near_limits(at, steps) | _unresolved(at, steps) | _near_singular(at, steps)


def _near_limits(at: RunState, steps: _Steps) -> Array:
    """Return in which steps a margin is or may be negative, or has a minimum to refine, (k,)."""
    signals = at.segment.signals
    m = steps.margins[..., signals.limited]
    if not m.size:
        return np.zeros(len(m), dtype=bool)
    here = m[:, 1:]  # without the evaluation before the step
    if signals.grasps_limited:  # forces that are not unique are chosen by the reference
        unique = steps.points["rank"] == at.segment.environment.chain.constraint_row_count
        found = ~unique.all(axis=1)
    else:
        found = np.zeros(len(m), dtype=bool)
    lowest = here.min(axis=1)
    least = np.minimum.accumulate(np.concatenate([at.checkpoint.tracker.lowest[None, signals.limited], lowest]))[1:]
    found |= (lowest < 0.0).any(axis=1)
    found |= may_cross(here[:, 0], here[:, 1], here[:, 2]).any(axis=1)
    found |= may_cross(here[:, -1], here[:, -2], here[:, -3]).any(axis=1)
    found[minima(m, least)[0]] = True
    return found


def _unresolved(at: RunState, steps: _Steps) -> Array:
    """Return in which steps the velocities change otherwise than by the mean of the accelerations, (k,)."""
    v, a = _velocities(steps.nodes), _accelerations(steps.nodes)
    jump = leap(steps.lengths, v[:-1], v[1:], a[:-1], a[1:])
    return ~(jump <= OF_MOTION * _largest(at, steps) + IGNORED_RATE)


def _largest(at: RunState, steps: _Steps) -> Array:
    """Return the largest velocities of the run up to the end of each step, (k,) [rad/s or m/s]."""
    largest = np.maximum.accumulate(np.abs(_velocities(steps.nodes)).max(axis=-1))[1:]
    return np.maximum(largest, at.checkpoint.resolution.largest)


def _velocities(x: Mapping[str, Array]) -> Array:
    return np.concatenate([x[name] for name in ("qd", "object_twist", "floating_twist") if name in x], axis=-1)


def _accelerations(x: Mapping[str, Array]) -> Array:
    names = ("qdd", "object_acceleration", "floating_acceleration")
    return np.concatenate([x[name] for name in names if name in x], axis=-1)


def _near_singular(at: RunState, steps: _Steps) -> Array:
    """Return in which steps the constraint may lose rank, or changes so much that the step may be too long, (k,)."""
    segment, x, h = at.segment, steps.nodes, steps.lengths[:, 0]
    chain, goes_on = segment.environment.chain, segment.settings.policy.on_singular == "continue"
    if segment.generic_rank <= chain.contact_freedom_count:
        return np.zeros(len(h), dtype=bool)
    s = chain_strength(x["condition"])
    before = s[0] if at.previous is None else chain_strength(np.array(at.previous.result.condition))
    found = changes_much(np.concatenate([[before], s[:-2]]), s[:-1], s[1:])
    sizes = np.ones(chain.joint_count)
    if not all(joint.turns for joint in chain.all_joints):
        sizes = SHORTER * coordinate_sizes(chain_at_rest(at.now.chain, at.now.state))[: chain.joint_count]
        sizes[[joint.turns for joint in chain.all_joints]] = 1.0
    turning = np.max(
        [np.abs(x[name][:, :3]).max(axis=1) for name in ("object_twist", "floating_twist") if name in x], axis=0
    )
    moved = np.maximum(
        (np.abs(np.diff(x["q"], axis=0)) / sizes).max(axis=1, initial=0.0), h * np.maximum(turning[:-1], turning[1:])
    )
    found |= may_lose(s[:-1] + s[1:], moved)
    if goes_on:  # whether a configuration lies ahead
        ahead = 2.0 * segment.settings.longest_step
        by_joints = np.abs(ahead * x["qd"] + 0.5 * ahead**2 * x["qdd"])[:-1] / sizes
        found |= may_lose(s[:-1], np.maximum(by_joints.max(axis=1, initial=0.0), ahead * turning[:-1]))
    return found


def _accepted(at: RunState, stepper: FusedStepper, steps: _Steps, count: int) -> Stretch:
    """Return the first steps as a part of the run."""
    segment, saved = at.segment, at.checkpoint
    x = {name: array[:count, -1].copy() for name, array in steps.points.items()}
    ends, margins, times = steps.times[:count, -1], steps.margins[:count, 1:], steps.times[:count]

    def instant(k: int) -> Instant:
        return stepper.instant(x, k, float(ends[k]), at.now.memory)

    work = np.cumsum(np.concatenate([saved.sums.work[None], x["work"]]), axis=0)[1:]
    of_grasps = margins[:, -1, : len(segment.environment.chain.arms)]
    samples = Samples(
        ends,
        _with_forces(x, instant, segment),
        (of_grasps, of_grasps, of_grasps),
        x["gaps"],
        work,
        *lowest_of(times, margins),
    )
    run = recorded(segment.environment, segment.stepper.accounts, samples, saved.sums)
    passed = [at.now.memory, *(x["memory"] if "memory" in x else [at.now.memory] * count)]
    lowest = np.minimum.accumulate(np.concatenate([saved.tracker.lowest[None], margins.min(axis=1)]))[1:]
    largest = _largest(at, steps)

    def after(k: int) -> Checkpoint:
        origins = [saved.now, *(Origin(float(ends[j]), state_of(x, j), passed[j]) for j in range(max(0, k - 1), k + 1))]
        return replace(
            saved,
            now=origins[-1],
            previous=origins[-2],
            tail_time=float(times[k, -2]),
            tail=margins[k, -2],
            stop=saved.stop + k + 1,
            sums=saved.sums._replace(work=work[k]),
            tracker=replace(saved.tracker, lowest=lowest[k]),
            resolution=saved.resolution._replace(largest=float(largest[k]), in_a_row=0),
        )

    last = count - 1
    earlier = at.now if count == 1 else instant(last - 1)
    end = RunState(segment, after(last), instant(last), earlier, gaps_of(x, last), times[last], margins[last])
    return Stretch(run, end, after)


def _with_forces(x: Mapping[str, Array], instant: Callable[[int], Instant], segment: Segment) -> Mapping[str, Array]:
    """Return the arrays at the ends of steps; forces that are not unique are the smallest ones."""
    if (x["rank"] == segment.environment.chain.constraint_row_count).all():
        return x
    found = [arrays_of(instant(k)) for k in range(len(x["rank"]))]
    forces = ("grasp_wrench", "base_wrench", "trunk_base_wrench")
    return {**x, **{name: np.concatenate([one[name] for one in found]) for name in forces if name in found[0]}}
