"""Steps of many systems in equal parts, where a whole one is too long; see `simulation.subdivision`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from holdfast.simulation.rollout.advance import OPEN
from holdfast.simulation.rollout.systems import RolloutSystems
from holdfast.simulation.subdivision import MOST_PARTS, parts_needed
from holdfast.spatial.scalar import Array

# (systems, step) -> None: one step in place
Advance = Callable[[RolloutSystems, Array], None]


def subdivided(systems: RolloutSystems, limit: float, order: int, advance: Advance) -> None:
    """Take one step in place, in parts for the systems that it leaves open by more than a limit before projection.

    Args:
        systems: at their pace.
        limit: of the position gaps [m or rad].
        order: of the scheme.
        advance: takes a step.
    """
    before = systems.copy()
    advance(systems, before.pace)
    far = systems.arrays["code"] == OPEN
    drift = np.where(systems.running, systems.drift[:, 0], 0.0)
    parts = np.where(far, MOST_PARTS, parts_needed(drift, limit, order))
    for count in np.unique(parts[before.running & (parts > 1)]):
        rows = np.flatnonzero(before.running & (parts == count))
        begin = before.copy(rows)
        end = in_parts(begin, int(count), advance)
        on, t = end.running, end.t
        end.begin, end.pace = np.where(on, begin.begin, t), begin.pace
        end.arrays["count"][...] = np.where(on, begin.arrays["count"] + 1.0, 0.0)
        systems.put(rows, end)


def in_parts(begin: RolloutSystems, parts: int, advance: Advance) -> RolloutSystems:
    """Return systems after a step in equal parts; what the law remembers moves on once, as in a whole step.

    Args:
        begin: at their pace.
        parts: how many.
        advance: takes a step.
    """
    systems, gaps = begin.copy(), np.zeros((len(begin), 4))
    for _ in range(parts):
        if "memory" in systems.arrays:
            systems.arrays["memory"][...] = begin.arrays["memory"]
        advance(systems, begin.pace / parts)
        gaps = np.maximum(gaps, systems.arrays["gaps"])
    systems.arrays["gaps"][...] = gaps
    return systems
