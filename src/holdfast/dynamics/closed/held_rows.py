"""Which rows of the grasp constraint a step holds, where some follow from the others everywhere.

On the constraint's manifold the pivot of a dependent row is rounding. A Runge-Kutta stage lies beside the manifold, by
d, and there the same pivot is of the order of d^2: no tolerance tells it from a weak one, and a dependent row that
passes for an independent one asks for accelerations that have nothing to do with the motion. So the rows are chosen
where a step begins, on the manifold: as many as the generic rank says, the same at every stage and in the projection
at its end. The others need no holding, they follow. What is held is then a constraint of full rank, and the step's
slope a smooth function beside the manifold too: the scheme keeps its order (docs/theory/simulation.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.closed.object_filter import ObjectSolution, object_filter
from holdfast.dynamics.closed.object_motion import FreeBody
from holdfast.dynamics.closed.tip_response import TipResponse
from holdfast.spatial.linalg import RANK_TOLERANCE
from holdfast.spatial.scalar import Array, Scalar, array, select, where

if TYPE_CHECKING:
    from holdfast.dynamics.closed.chain_motion import ChainMotion

# Relative pivots below which a row is passed over, as long as enough rows are left: rows far from dependent are held
# rather than weak ones, which soon would be.
TOLERANCES = (1e-2, 1e-4, 1e-8, RANK_TOLERANCE)


def strongest_rows(
    contacts: list[Contact], tips: list[TipResponse], body: FreeBody, generic_rank: Scalar
) -> ObjectSolution:
    """Return the solution that holds the strongest independent rows, at a closed state. O(l).

    The rows held are its `independent` ones. Its rank is the generic one, or less at a singular configuration.

    Args:
        contacts: the grasps; rows that they already leave out stay out.
        tips: the arms' answers at their tips.
        body: the object.
        generic_rank: of the constraint away from singular configurations.
    """
    rows = [c if c.held is not None else replace(c, held=np.ones(6)) for c in contacts]
    *stronger, found = [object_filter(rows, tips, body, tolerance) for tolerance in TOLERANCES]
    for one in stronger[::-1]:
        found = _chosen(one.rank >= generic_rank, one, found)
    return found


def _chosen(first: Scalar, a: ObjectSolution, b: ObjectSolution) -> ObjectSolution:
    """Return the first of two solutions if so, else the second."""

    def of(x: Sequence[Any], y: Sequence[Any]) -> list[Any]:
        return [select(first, one, other) for one, other in zip(x, y, strict=True)]

    return ObjectSolution(
        of(a.wrenches, b.wrenches),
        select(first, a.object_acceleration, b.object_acceleration),
        select(first, a.mobility, b.mobility),
        where(first, a.rank, b.rank),
        where(first, a.weakest_pivot, b.weakest_pivot),
        of(a.independent, b.independent),
    )


def held_components(contacts: Sequence[Contact], independent: Sequence[Any]) -> Array | None:
    """Return (grasps, 6) 1 for the components along each grasp's axes that are held, from masks of its rows.

    None where no rows were chosen.
    """
    if any(mask is None for mask in independent) or not independent:
        return None
    pairs = zip(contacts, independent, strict=True)
    return array([[mask[c.rows.index(i)] if i in c.rows else 0.0 for i in range(6)] for c, mask in pairs])


def holding(motion: ChainMotion, held: Array | None) -> ChainMotion:
    """Return the chain in motion with only some components of the grasps held.

    Args:
        motion: the chain.
        held: (grasps, 6) as `held_components` returns them; None: all, as they are.
    """
    if held is None:
        return motion
    contacts = [replace(c, held=mask) for c, mask in zip(motion.contacts, held, strict=True)]
    return replace(motion, contacts=contacts)
