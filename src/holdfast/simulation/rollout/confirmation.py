"""A rollout's slip, limit or singularity is believed only where shorter steps show it too, as in `simulate`."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from holdfast.simulation.confirmation import PARTS, ROUNDING, SHARE
from holdfast.simulation.rollout.advance import LIMITED, SINGULAR
from holdfast.simulation.rollout.subdivision import Advance, in_parts
from holdfast.simulation.rollout.systems import RolloutSystems
from holdfast.spatial.scalar import Array


def contradicted(stopped: RolloutSystems, begin: RolloutSystems, least: Mapping[int, float], advance: Advance) -> Array:
    """Return which systems were stopped by a step that is too long, (systems,).

    Args:
        stopped: systems that have just slipped, passed a limit or turned singular, at their last good states.
        begin: the same, free to go on.
        least: margins that stop a system, by its code: of every one-sided contact, of every joint limit.
        advance: takes a step.
    """
    code = stopped.arrays["code"]
    whole = in_parts(begin, 1, advance)
    found = np.zeros(len(begin), dtype=bool)
    shorter = [in_parts(begin, parts, advance) for parts in PARTS]
    for kind, bound in least.items():
        shown = code == kind
        if not shown.any():
            continue
        before, after = (_margins(one, kind) for one in (begin, whole))
        fallen = after < bound
        m0, m1 = (np.where(fallen, m, 0.0) for m in (before, after))
        allowed = SHARE * np.abs(m1 - m0) + ROUNDING * np.maximum(1.0, np.abs(m1))
        for systems in shorter:
            m = np.where(fallen, _margins(systems, kind), 0.0)
            found |= shown & (~systems.running | ~(np.abs(m - m1) <= allowed).all(axis=1))
    return found | ((code == SINGULAR) & np.all([systems.running for systems in shorter], axis=0))


def _margins(systems: RolloutSystems, kind: int) -> Array:
    """Return the margins that a kind of stop looks at, (systems, ...)."""
    return systems.joint_margin.reshape(len(systems), -1) if kind == LIMITED else systems.margin
