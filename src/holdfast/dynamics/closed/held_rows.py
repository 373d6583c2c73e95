"""Which rows of the grasp constraint a step holds, where some follow from the others everywhere.

On the constraint's manifold the pivot of a dependent row is rounding. A Runge-Kutta stage lies beside the manifold, by
d, and there the same pivot is of the order of d^2: no tolerance tells it from a weak one, and a dependent row that
passes for an independent one asks for accelerations that have nothing to do with the motion. So the rows are chosen
where a step begins, on the manifold: as many as the generic rank says, the same at every stage and in the projection
at its end. The others need no holding, they follow. What is held is then a constraint of full rank, and the step's
slope a smooth function beside the manifold too: the scheme keeps its order (docs/theory/simulation.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion
from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.closed.object_filter import ObjectSolution, object_filter
from holdfast.dynamics.closed.tip_response import TipResponse
from holdfast.spatial.linalg import RANK_TOLERANCE
from holdfast.spatial.scalar import Array, Scalar, array, select, where

# Relative pivots below which a row is passed over, as long as enough rows are left: rows far from dependent are held
# rather than weak ones, which soon would be.
TOLERANCES = (1e-2, 1e-4, 1e-8, RANK_TOLERANCE)


Solve = Callable[[list[Contact], float], ObjectSolution]


def with_strongest_rows(
    motion: ChainMotion, tips: list[TipResponse], generic_rank: Scalar
) -> tuple[ObjectSolution, Array]:
    """Return the solution that holds the strongest independent rows, at a closed state, and those rows. O(l).

    Its rank is the generic one, or less at a singular configuration.

    Args:
        motion: the chain; rows that its contacts already leave out stay out.
        tips: the arms' answers at their tips.
        generic_rank: of the constraint away from singular configurations.

    Returns:
        The solution, and (grasps, 1, 6) 1 for the components along each grasp's axes that are held. With grasps that
        constrain a rate only (grasps, 2, 6): in velocity, then in position, where there are fewer rows.
    """
    contacts, body = motion.contacts, motion.body.free
    return strongest_rows(lambda rows, tolerance: object_filter(rows, tips, body, tolerance), contacts, generic_rank)


def strongest_rows(solve: Solve, contacts: list[Contact], generic_rank: Scalar) -> tuple[ObjectSolution, Array]:
    """Return what `with_strongest_rows` does, for any filter.

    Args:
        solve: contacts that say which rows are held, relative size of a pivot that counts as zero -> solution.
        contacts: the grasps.
        generic_rank: of the constraint away from singular configurations.
    """
    found = _strongest(solve, contacts, generic_rank)
    held = [_components(contacts, found.independent)]
    if any(c.grasp.of_kind.rate_rows for c in contacts):
        of_positions = [replace(c, rows=c.grasp.of_kind.position_rows) for c in contacts]
        held.append(_components(of_positions, _strongest(solve, of_positions, None).independent))
    return found, np.stack(held, axis=1)


def _strongest(solve: Solve, contacts: list[Contact], generic_rank: Scalar | None) -> ObjectSolution:
    """Return the solution with the largest pivots that has the generic rank; None: the rank here."""
    rows = [c if c.held is not None else replace(c, held=np.ones(6)) for c in contacts]
    *stronger, found = [solve(rows, tolerance) for tolerance in TOLERANCES]
    rank = found.rank if generic_rank is None else generic_rank
    for one in stronger[::-1]:
        found = _chosen(one.rank >= rank, one, found)
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


def _components(contacts: Sequence[Contact], independent: Sequence[Any]) -> Array:
    """Return (grasps, 6) masks of components from masks of rows."""
    pairs = zip(contacts, independent, strict=True)
    return array([[mask[c.rows.index(i)] if i in c.rows else 0.0 for i in range(6)] for c, mask in pairs])


def holding(motion: ChainMotion, held: Array | None, *, positions: bool = False) -> ChainMotion:
    """Return the chain in motion with only some components of the grasps held.

    Args:
        motion: the chain.
        held: as `with_strongest_rows` returns it; None: all, as they are.
        positions: hold those that are held in position.
    """
    if held is None:
        return motion
    masks = held[:, -1 if positions else 0]
    contacts = [replace(c, held=mask) for c, mask in zip(motion.contacts, masks, strict=True)]
    return replace(motion, contacts=contacts)
