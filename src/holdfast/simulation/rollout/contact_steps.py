"""Steps of systems with impulses of contacts, which are found in ever surer ways.

In rollouts first by a few of Newton's steps from the forces of the step before; for systems in which these do not
satisfy the laws, and in `simulate`, by the whole path of an interior point, by Newton's steps from no forces, and by
the path with more of Newton's steps at its end; what is left takes shorter steps. A system that is still left stops,
with a status that says so. Which way a system goes depends on that system alone, and so do its bits.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from holdfast.simulation.rollout.parts import counted_as_one
from holdfast.simulation.rollout.systems import RolloutSystems
from holdfast.simulation.rollout.traced_impulses import FROM_LAST, LONG_WAY, WHOLE_PATH
from holdfast.simulation.rollout.traced_step import RUNNING, UNLAWFUL
from holdfast.spatial.scalar import Array

LONGEST_STRETCH = 32  # steps
SHORTEST_PART = 2.0**-12  # of a step


class TakeSteps(Protocol):
    """Takes steps of a length (systems,) in place; a system whose impulses are not found keeps its state."""

    def __call__(self, systems: RolloutSystems, h: Array, *, way: str, steps: int = 1) -> None:
        """Take the steps, with impulses found in a way of `traced_impulses`."""
        ...


def with_impulses(systems: RolloutSystems, steps: int, take: TakeSteps, first: str = FROM_LAST) -> None:
    """Take steps in place, with the systems' step lengths.

    A system whose impulses are not found waits for the others, so that steps are taken in short stretches, and in ever
    shorter ones while there are such systems.

    Args:
        systems: the systems.
        steps: number of steps.
        take: takes steps in a given way.
        first: the way in which every step is tried first.
    """
    code, rows, end = systems.arrays["code"], np.flatnonzero(systems.running), systems.arrays["count"] + steps
    longest = LONGEST_STRETCH
    while len(rows):
        some = systems if len(rows) == len(systems) else systems.copy(rows)
        left = end[rows] - some.arrays["count"]
        take(some, some.step_length, way=first, steps=int(min(longest, left.min())))
        failed = np.flatnonzero(some.arrays["code"] == UNLAWFUL)
        if len(failed):
            few = some.freed(failed)
            _step_surely(few, take)
            some.put(failed, few)
        if some is not systems:
            systems.put(rows, some)
        longest = max(1, longest // 2) if len(failed) else min(2 * longest, LONGEST_STRETCH)
        rows = rows[(code[rows] == RUNNING) & (end[rows] - systems.arrays["count"][rows] > 0.5)]


def _step_surely(systems: RolloutSystems, take: TakeSteps) -> None:
    """Take one step in place, without the last forces: at once, or as much of what is left of it as succeeds.

    Where contacts lift, forces vanish and slips have no direction yet, impulses may not be found; steps that end
    shortly before such an instant are followed by one that passes it. Forces of contacts are means over the step.
    """
    before, gaps, rows = systems.copy(), np.zeros((len(systems), 4)), np.arange(len(systems))
    left, forces = before.step_length.copy(), np.zeros_like(systems.arrays["touch_force"])
    part = left.copy()
    while len(rows):
        few = systems.freed(rows)
        if "memory" in few.arrays:  # it is updated once, as in a whole step
            few.arrays["memory"][...] = before.arrays["memory"][rows]
        _without_last_forces(take, few, part[rows])
        systems.put(rows, few)
        done, failed = (few.arrays["code"] == code for code in (RUNNING, UNLAWFUL))
        gaps[rows] = np.where(failed[:, None], gaps[rows], np.maximum(gaps[rows], few.arrays["gaps"]))
        left[rows] -= np.where(done, part[rows], 0.0)
        share = np.where(done, part[rows] / before.step_length[rows], 0.0)
        forces[rows] += share[:, None, None] * few.arrays["touch_force"]
        part[rows] = np.where(failed, 0.5 * part[rows], left[rows])
        going = np.where(failed, part[rows] > SHORTEST_PART * before.step_length[rows], done & (left[rows] > 0.0))
        rows = rows[going]
    systems.arrays["gaps"][...] = gaps
    systems.arrays["touch_force"][systems.running] = forces[systems.running]
    counted_as_one(systems, before)


def _without_last_forces(take: TakeSteps, systems: RolloutSystems, h: Array) -> None:
    """Take a step in place by the whole path, or by a few steps from no forces, as where contacts just lift."""
    before = systems.copy()
    take(systems, h, way=WHOLE_PATH)
    for way in (FROM_LAST, LONG_WAY):
        rows = np.flatnonzero((systems.arrays["code"] == UNLAWFUL) & before.running)
        if not len(rows):
            return
        few = before.copy(rows)
        few.arrays["touch_force"][...] = 0.0
        take(few, h[rows], way=way)
        systems.put(rows, few)
