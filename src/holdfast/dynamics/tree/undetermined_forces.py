"""Which closures and couplings share the forces that nothing determines."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.dynamics.tree.forest_motion import ForestMotion
from holdfast.dynamics.tree.forest_rows import forest_rows, weighed_rows

SHARED = 1e-6  # entry of the projector onto null forces below which two closures share none


class UndeterminedForces(NamedTuple):
    """Forces that act on each other within a group of closures and couplings, and that no equation determines.

    Attributes:
        number: how many there are.
        closures: indices of the closures.
        couplings: indices of the couplings.
    """

    number: int
    closures: tuple[int, ...]
    couplings: tuple[int, ...]


def undetermined_forces(motion: ForestMotion, rank: int) -> list[UndeterminedForces]:
    """Return the smallest groups of closures and couplings that undetermined forces are confined to.

        G^T lambda = 0,  P = 1 - E E^+

    The projector P onto the null forces, in the metric of forces, is block diagonal over the groups, and the trace of a
    block is the number of its forces. O(rows^3).

    Args:
        motion: the forest's motion.
        rank: rank of its constraint.
    """
    rows = forest_rows(motion)
    N = np.linalg.svd(weighed_rows(motion, rows).E)[0][:, rank:]
    slots = [*rows.closures, *(slice(k, k + 1) for k in rows.couplings)]
    P = [[N[a] @ N[b].T for b in slots] for a in slots]
    left, found = [k for k in range(len(slots)) if np.abs(P[k][k]).max(initial=0.0) > SHARED], []
    while left:
        group = [left.pop(0)]
        for k in group:  # the loop appends to this list
            near = [other for other in left if np.abs(P[k][other]).max() > SHARED]
            group += near
            left = [other for other in left if other not in near]
        number, first = round(sum(float(np.trace(P[k][k])) for k in group)), len(rows.closures)
        closures, couplings = (tuple(sorted(k for k in group if (k < first) == of)) for of in (True, False))
        found.append(UndeterminedForces(number, closures, tuple(k - first for k in couplings)))
    return found
