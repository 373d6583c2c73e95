"""A rollout's slip or singularity is believed only where shorter steps show it too, as in `simulate`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from holdfast.simulation.confirmation import PARTS, ROUNDING, SHARE
from holdfast.simulation.rollout.advance import SLIPPED
from holdfast.simulation.rollout.systems import RolloutSystems
from holdfast.spatial.scalar import Array

# (systems, step) -> None: one step in place, whatever the margins
Advance = Callable[[RolloutSystems, Array], None]


def contradicted(stopped: RolloutSystems, begin: RolloutSystems, least_margin: float, advance: Advance) -> Array:
    """Return which systems were stopped by a step that is too long, (systems,).

    Args:
        stopped: systems that have just slipped or turned singular, at their last good states.
        begin: the same, free to go on.
        least_margin: of every one-sided contact [N].
        advance: takes a step.
    """
    slipped = stopped.arrays["code"] == SLIPPED
    whole = _taken(begin, 1, advance)
    found = np.zeros(len(begin), dtype=bool)
    shorter = [_taken(begin, parts, advance) for parts in PARTS]
    for systems in shorter:
        if not systems.margin.shape[1]:
            continue
        fallen = whole.margin < least_margin
        m0, m1, m = (np.where(fallen, one.margin, 0.0) for one in (begin, whole, systems))
        allowed = SHARE * np.abs(m1 - m0) + ROUNDING * np.maximum(1.0, np.abs(m1))
        found |= slipped & (~systems.running | ~(np.abs(m - m1) <= allowed).all(axis=1))
    return found | (~slipped & np.all([systems.running for systems in shorter], axis=0))


def _taken(begin: RolloutSystems, parts: int, advance: Advance) -> RolloutSystems:
    """Return systems after a step in equal parts; what the law remembers moves on once, as in a whole step."""
    systems = begin.copy()
    for _ in range(parts):
        if "memory" in systems.arrays:
            systems.arrays["memory"][...] = begin.arrays["memory"]
        advance(systems, begin.pace / parts)
    return systems
