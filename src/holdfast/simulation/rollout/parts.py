"""Steps of many systems in equal parts, to reduce the drift, or to confirm what a step shows.

As in `simulate`, a step that leaves the grasps too far open is divided into parts (`simulation.stepper`), and a slip, a
limit or a singularity counts only if shorter steps show it, too (`simulation.confirmation`). A step that may not follow
the motion (`simulation.resolution`) is compared with its halves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from holdfast.dynamics.near_singular import chain_strength
from holdfast.simulation.confirmation import NEGLIGIBLE_DIFFERENCE, SHARE, SHORTER_BY
from holdfast.simulation.resolution import least_difference
from holdfast.simulation.rollout.arguments import NO_STOPS, StopMargins
from holdfast.simulation.rollout.rows import velocities_in
from holdfast.simulation.rollout.singular_steps import BESIDE
from holdfast.simulation.rollout.systems import RolloutSystems, resolution_of
from holdfast.simulation.rollout.traced_step import (
    BROKEN,
    GRASP_OPEN,
    LIMITED,
    PASSES_SINGULAR,
    RUNNING,
    SLIPPED,
    UNRESOLVED,
)
from holdfast.simulation.stepper import MOST_SUBSTEPS, parts_needed
from holdfast.spatial.scalar import Array

HALVINGS = 50  # of a step, when the instant of a slip or limit is sought
TakeStep = Callable[..., None]  # function (systems, step lengths) that takes one step in place


def followed(
    systems: RolloutSystems, steps: int, take: TakeStep, least: StopMargins, limit: float | None, order: int
) -> None:
    """Take steps in place; those that may not follow the motion are compared with their halves.

    Args:
        systems: the systems, with their step lengths set.
        steps: number of steps.
        take: takes steps, as `Rollout.advance_unconfirmed` does.
        least: margins below which a system stops.
        limit: as for `subdivided`; None: no step is divided.
        order: order of the scheme.
    """

    def taken(some: RolloutSystems, count: int) -> None:
        if limit is None:
            take(some, some.step_length, steps=count, least=least, wait=True)
            return
        for _ in range(count):
            subdivided(some, limit, order, partial(take, steps=1, least=least))

    end = systems.arrays["count"] + steps
    taken(systems, steps)
    code = systems.arrays["code"]
    waiting = code == UNRESOLVED
    rows = np.flatnonzero(waiting)
    while len(rows):
        left, some = end - systems.arrays["count"], systems.freed(rows)
        if waiting.any():
            halves = in_parts(some, SHORTER_BY[0], partial(take, steps=1, least=NO_STOPS))
            taken(some, 1)
            _compare(some, halves)
        else:
            taken(some, int(left[rows].min()))
        systems.put(rows, some)
        waiting = code == UNRESOLVED
        rows = np.flatnonzero(waiting if waiting.any() else (code == RUNNING) & (systems.arrays["count"] < end))


def _compare(systems: RolloutSystems, halves: RolloutSystems) -> None:
    """Store by how much velocities differ from those after the same step in halves, where this counts."""
    largest, _, _, off = resolution_of(systems)
    v, w = (velocities_in(one.arrays) for one in (systems, halves))
    found = np.where(halves.running, np.abs(v - w).max(axis=1), np.inf)
    off[...] = np.where(systems.running & (found > least_difference(largest)), np.maximum(off, found), off)


def diverged(systems: RolloutSystems) -> Array:
    """Return which systems stopped because a step failed, after steps that did not follow the motion, (systems,)."""
    largest, in_a_row, _, off = resolution_of(systems)
    failed = np.isin(systems.arrays["code"], (GRASP_OPEN, BROKEN))
    return failed & (in_a_row > 0.0) & (off > least_difference(largest))


def subdivided(systems: RolloutSystems, limit: float, order: int, advance: TakeStep) -> None:
    """Take one step in place, in parts for systems whose position gap before projection exceeds a limit.

    Args:
        systems: the systems, with their step lengths set.
        limit: greatest accepted position gap [m or rad].
        order: order of the scheme.
        advance: takes a step.
    """
    before = systems.copy()
    advance(systems, before.step_length, wait=True)
    far = systems.arrays["code"] == GRASP_OPEN
    drift = np.where(systems.running, systems.drift[:, 0], 0.0)
    parts = np.where(far, MOST_SUBSTEPS, parts_needed(drift, limit, order))
    for count in np.unique(parts[before.running & (parts > 1)]):
        rows = np.flatnonzero(before.running & (parts == count))
        systems.put(rows, as_one_step(before.copy(rows), int(count), advance))


def as_one_step(begin: RolloutSystems, parts: int, advance: TakeStep) -> RolloutSystems:
    """Return systems after a step in equal parts, which counts as one; a system that stops keeps its own time."""
    end = in_parts(begin, parts, advance)
    counted_as_one(end, begin)
    return end


def counted_as_one(end: RolloutSystems, begin: RolloutSystems) -> None:
    """Count what was done since the step's start as one step, in place; a system that stops keeps its own time."""
    on, t = end.running, end.t
    end.begin, end.step_length = np.where(on, begin.begin, t), begin.step_length
    end.arrays["count"][...] = np.where(on, begin.arrays["count"] + 1.0, 0.0)


def in_parts(begin: RolloutSystems, parts: int, advance: TakeStep) -> RolloutSystems:
    """Return systems after a step in equal parts; the law's memory is updated once, as in a whole step.

    Args:
        begin: the systems at the step's start, with their step lengths set.
        parts: number of parts.
        advance: takes a step.
    """
    systems, gaps = begin.copy(), np.zeros((len(begin), 4))
    for _ in range(parts):
        if "memory" in systems.arrays:
            systems.arrays["memory"][...] = begin.arrays["memory"]
        advance(systems, begin.step_length / parts)
        gaps = np.maximum(gaps, systems.arrays["gaps"])
    systems.arrays["gaps"][...] = gaps
    return systems


def contradicted(
    stopped: RolloutSystems, begin: RolloutSystems, least: Mapping[int, float], advance: TakeStep
) -> Array:
    """Return which systems stopped only because the step is too long, (systems,).

    Args:
        stopped: systems that have just slipped, passed a limit or become singular, at their last good states.
        begin: the same systems before they stopped.
        least: margins below which a system stops, by status code: for one-sided contacts and for joint limits.
        advance: takes a step.
    """
    code = stopped.arrays["code"]
    whole = in_parts(begin, 1, advance)
    found = np.zeros(len(begin), dtype=bool)
    shorter = [in_parts(begin, parts, advance) for parts in SHORTER_BY]
    for kind, bound in least.items():
        shown = code == kind
        if not shown.any():
            continue
        before, after = (_margins(one, kind) for one in (begin, whole))
        fallen = after < bound
        m0, m1 = (np.where(fallen, m, 0.0) for m in (before, after))
        allowed = SHARE * np.abs(m1 - m0) + NEGLIGIBLE_DIFFERENCE * np.maximum(1.0, np.abs(m1))
        for systems in shorter:
            m = np.where(fallen, _margins(systems, kind), 0.0)
            found |= shown & (~systems.running | ~(np.abs(m - m1) <= allowed).all(axis=1))
    ends = np.array([chain_strength(systems.arrays["condition"]) for systems in (begin, shorter[-1])])
    beside = ends.min(axis=0) < BESIDE * ends.sum(axis=0)  # near singular configurations, shorter steps may agree
    return found | ((code == PASSES_SINGULAR) & ~beside & np.all([systems.running for systems in shorter], axis=0))


def _margins(systems: RolloutSystems, kind: int) -> Array:
    """Return the margins that belong to a status code, (systems, ...)."""
    return systems.joint_margin.reshape(len(systems), -1) if kind == LIMITED else systems.margin


def refined(at: RolloutSystems, rows: Array, step: float, advance: TakeStep) -> Array:
    """Return when systems slip or pass a limit, by halving the step that would go too far.

    Which of both a system does first becomes its status.

    Args:
        at: the systems.
        rows: (systems,) which of them.
        step: h [s].
        advance: takes a step of a length (systems,) in place, and stops those that slip or pass a limit.
    """
    begin = at.freed(rows)
    low, high, code = np.zeros(len(begin)), np.full(len(begin), step), at.arrays["code"][rows]
    for _ in range(HALVINGS):
        middle, trial = 0.5 * (low + high), begin.copy()
        advance(trial, middle)
        shown = np.isin(trial.arrays["code"], (SLIPPED, LIMITED))
        code = np.where(shown, trial.arrays["code"], code)
        low, high = np.where(trial.running, middle, low), np.where(trial.running, high, middle)
    at.arrays["code"][rows] = code
    return begin.t + low
