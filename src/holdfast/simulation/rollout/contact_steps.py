"""Steps of many systems with impulses of contacts, which are found in ever surer ways.

First by a few of Newton's steps from the forces of the step before; for systems in which these do not satisfy the laws,
by the whole path of an interior point, and by Newton's steps from no forces; for what is left, in equal parts of the
step. A system that is still left stops, with a status that says so. Which way a system goes depends on that system
alone, and so do its bits.
"""

from __future__ import annotations

from functools import partial
from typing import Protocol

import numpy as np

from holdfast.simulation.rollout.parts import as_one_step
from holdfast.simulation.rollout.systems import RolloutSystems
from holdfast.simulation.rollout.traced_impulses import FROM_LAST, WHOLE_PATH
from holdfast.simulation.rollout.traced_step import RUNNING, UNLAWFUL
from holdfast.spatial.scalar import Array

LONGEST_STRETCH = 32  # steps
# of a step whose impulses are not found: steps that are short enough pass the instant at which contacts lift, where
# forces vanish and slips have no direction yet
PARTS_OF_FAILED = (2, 3, 5, 8, 16, 32, 64, 128)


class TakeSteps(Protocol):
    """Takes steps of a length (systems,) in place; a system whose impulses are not found keeps its state."""

    def __call__(self, systems: RolloutSystems, h: Array, *, way: str, steps: int = 1) -> None:
        """Take the steps, with impulses found in a way, `FROM_LAST` or `WHOLE_PATH`."""
        ...


def with_impulses(systems: RolloutSystems, steps: int, take: TakeSteps) -> None:
    """Take steps in place, with the systems' step lengths.

    A system whose impulses are not found waits for the others, so that steps are taken in short stretches, and in ever
    shorter ones while there are such systems.
    """
    code, rows, end = systems.arrays["code"], np.flatnonzero(systems.running), systems.arrays["count"] + steps
    longest = LONGEST_STRETCH
    while len(rows):
        some = systems if len(rows) == len(systems) else systems.copy(rows)
        left = end[rows] - some.arrays["count"]
        take(some, some.step_length, way=FROM_LAST, steps=int(min(longest, left.min())))
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
    """Take one step in place, without the last forces, and in parts where this fails."""
    before, without = systems.copy(), partial(_without_last_forces, take)
    without(systems, systems.step_length)
    for parts in PARTS_OF_FAILED:
        rows = np.flatnonzero(systems.arrays["code"] == UNLAWFUL)
        if not len(rows):
            return
        systems.put(rows, as_one_step(before.copy(rows), parts, without))


def _without_last_forces(take: TakeSteps, systems: RolloutSystems, h: Array) -> None:
    """Take a step in place by the whole path, or by a few steps from no forces, as where contacts just lift."""
    before = systems.copy()
    take(systems, h, way=WHOLE_PATH)
    rows = np.flatnonzero((systems.arrays["code"] == UNLAWFUL) & before.running)
    if len(rows):
        few = before.copy(rows)
        few.arrays["touch_force"][...] = 0.0
        take(few, h[rows], way=FROM_LAST)
        systems.put(rows, few)
