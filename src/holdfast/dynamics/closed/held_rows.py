"""The choice of the rows of the grasp constraint that a step imposes, if some rows depend on others everywhere.

On the constraint manifold, the pivot of a dependent row is only rounding. A Runge-Kutta stage is off the manifold by a
distance d, where the same pivot is of the order of d^2. No tolerance can distinguish it from the pivot of a weak row,
and a dependent row that is taken for an independent one causes accelerations that have nothing to do with the motion.
The rows are therefore chosen at the start of a step, on the manifold: as many as the generic rank, and the same ones at
every stage and in the projection at the end. The other rows follow from them. The imposed constraint then has full
rank, and the slope is a smooth function off the manifold, too, so the scheme keeps its order
(docs/theory/simulation.md).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion
from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.tree.of_chain import ChainElimination
from holdfast.dynamics.trunk.trunk_motion import TrunkAcceleration
from holdfast.spatial.linalg import RANK_TOLERANCE
from holdfast.spatial.scalar import Array, Scalar, array, select, where

# Relative pivots below which a row is skipped, as long as enough rows are left. Clearly independent rows are preferred
# to weak ones, which would soon be dependent.
TOLERANCES = (1e-2, 1e-4, 1e-8, RANK_TOLERANCE)


# What differs between solutions that impose different rows.
CHOSEN = (
    "wrenches",
    "object_acceleration",
    "trunk",
    "betas",
    "columns",
    "rank",
    "weakest_pivot",
    "independent",
    "pivots",
)

Solve = Callable[[list[Contact], float], ChainElimination]


def strongest_rows(solve: Solve, contacts: list[Contact], generic_rank: Scalar) -> tuple[ChainElimination, Array]:
    """Return the solution that imposes the strongest independent rows at a closed state, and these rows. O(l).

    Its rank is the generic rank, or less at a singular configuration.

    Args:
        solve: function of contacts with masks and of the relative pivot that counts as zero, which returns the
            solution.
        contacts: the grasps; rows that they already leave out are not considered.
        generic_rank: rank of the constraint away from singular configurations.

    Returns:
        The solution, and a mask (grasps, 1, 6) with 1 for the imposed components along each grasp's axes. If some
        grasps constrain a rate only, the mask is (grasps, 2, 6): first for velocities, then for positions, which have
        fewer rows.
    """
    found = _strongest(solve, contacts, generic_rank)
    held = [_components(contacts, found.independent)]
    if any(c.grasp.of_kind.rate_rows for c in contacts):
        of_positions = [replace(c, rows=c.grasp.of_kind.position_rows) for c in contacts]
        held.append(_components(of_positions, _strongest(solve, of_positions, None).independent))
    return found, np.stack(held, axis=1)


def _strongest(solve: Solve, contacts: list[Contact], generic_rank: Scalar | None) -> ChainElimination:
    """Return the solution with the largest pivots among those of the generic rank (None: of the rank at this state)."""
    rows = [c if c.held is not None else replace(c, held=np.ones(6)) for c in contacts]
    *stronger, found = [solve(rows, tolerance) for tolerance in TOLERANCES]
    rank = found.rank if generic_rank is None else generic_rank
    for one in stronger[::-1]:
        found = _chosen(one.rank >= rank, one, found)
    return found


def _chosen(first: Scalar, a: ChainElimination, b: ChainElimination) -> ChainElimination:
    """Return solution a if `first` is true, otherwise b; `first` may be a traced number."""
    chosen = {name: _either(first, getattr(a, name), getattr(b, name)) for name in CHOSEN}
    return a._replace(**chosen, factors=None)


def _either(first: Scalar, x: Any, y: Any) -> Any:
    """Return x if `first` is true, otherwise y: numbers, arrays, and what consists of them."""
    if x is None:
        return None
    if isinstance(x, Mapping):
        return {name: _either(first, one, y[name]) for name, one in x.items()}
    if isinstance(x, TrunkAcceleration):
        return TrunkAcceleration(*(_either(first, one, other) for one, other in zip(x, y, strict=True)))
    if isinstance(x, list | tuple):
        return [_either(first, one, other) for one, other in zip(x, y, strict=True)]
    return select(first, x, y) if isinstance(x, np.ndarray) and x.ndim else where(first, x, y)


def _components(contacts: Sequence[Contact], independent: Sequence[Any]) -> Array:
    """Return masks of components, (grasps, 6), from masks of rows."""
    pairs = zip(contacts, independent, strict=True)
    return array([[mask[c.rows.index(i)] if i in c.rows else 0.0 for i in range(6)] for c, mask in pairs])


def holding(motion: ChainMotion, held: Array | None, *, positions: bool = False) -> ChainMotion:
    """Return the chain's motion with only some components of the grasps imposed.

    Args:
        motion: the chain's motion.
        held: mask as returned by `strongest_rows`; None leaves the motion unchanged.
        positions: use the mask for positions instead of that for velocities.
    """
    if held is None:
        return motion
    masks = held[:, -1 if positions else 0]
    contacts = [replace(c, held=mask) for c, mask in zip(motion.contacts, masks, strict=True)]
    return replace(motion, contacts=contacts)
