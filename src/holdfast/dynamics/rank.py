"""The rank of the grasp constraint at a configuration, and its generic rank (docs/theory/singular.md).

The generic rank is the largest rank at a few closed neighbours. If the rank is deficient but generic, the forces are
indeterminate everywhere, and the accelerations are correct. If the rank is lower than the generic rank, the
configuration is singular, and the solution at this point is not that of a trajectory.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_at_rest
from holdfast.dynamics.closed.sequential import rest_response, sequential
from holdfast.dynamics.closing import close
from holdfast.dynamics.consistency import largest_position
from holdfast.dynamics.constraint import coordinate_sizes
from holdfast.dynamics.object_level import motion_basis
from holdfast.dynamics.projection import CLOSED_GAP, WIDEST_GAP, displacement, moved
from holdfast.dynamics.result import Status
from holdfast.errors import ClosureError, SingularChainError, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State

NEIGHBOURS = 8
NEIGHBOUR_DISTANCE = 0.1  # rad, or fraction of the arms' reach
SHORTER = (1.0, 0.25, 0.0625)  # fractions of this distance to try in turn
STRAYED = 3.0  # a closed state that is farther away than this multiple is not a neighbour
TANGENT_STEPS = (0.05, 0.005, 0.0005)  # the same: near a singular configuration only short ones lead on
# A row that follows from others has a relative pivot of about gap^2 beside the constraint, gap in m or rad. What is
# larger than that by far is no such row.
ROW_PER_GAP = 100.0  # square root of the relative pivot, divided by the gap
SUSPECT_GAP = 1e-1  # square root of the largest relative pivot that is checked


class Regularity(NamedTuple):
    """The classification of a configuration by comparison with its neighbours.

    Attributes:
        kind: "regular" (full rank), "indeterminate" (the same deficient rank nearby) or "singular".
        generic_rank: the rank nearby.
        why: for a singular configuration, how it was recognised.
    """

    kind: Literal["regular", "indeterminate", "singular"]
    generic_rank: int
    why: str


class Pivots(NamedTuple):
    """Rank and condition of the grasp constraint, from the pivots of the object filter.

    Attributes:
        rank: number of nonzero pivots.
        condition: inverse of the smallest of these, relative to its scale, as in `ForwardResult`.
    """

    rank: int
    condition: float


@np.errstate(all="ignore")  # what overflows is refused
def constraint_pivots(chain: ClosedChain, state: State) -> Pivots:
    """Return the rank and condition of [J, -A, H^T] at a configuration, as in forward dynamics.

    Raises:
        StateError: they overflow.
    """
    found = rest_response(chain_at_rest(chain, state))
    checks.finite(np.append(found.mobility, found.weakest_pivot), "the rank of the constraint")
    return Pivots(int(found.rank), 1.0 / float(found.weakest_pivot))


def constraint_rank(chain: ClosedChain, state: State) -> int:
    """Return the rank of [J, -A, H^T] at a configuration."""
    return constraint_pivots(chain, state).rank


def generic_constraint_rank(chain: ClosedChain, state: State) -> int:
    """Return the largest rank at 8 closed neighbours, about 0.1 rad away in seeded random directions.

    A structure without closed neighbours cannot move; its own rank is returned.
    """
    best = constraint_rank(chain, state)
    still, sizes = _still(chain, state)
    for seed in range(NEIGHBOURS):
        step = NEIGHBOUR_DISTANCE * np.random.default_rng(seed).uniform(-1, 1, len(sizes))
        neighbour = _neighbour(chain, still, sizes, step)
        if neighbour is not None:
            best = max(best, constraint_rank(chain, neighbour))
        if best == chain.constraint_row_count:
            break
    return best


def _neighbour(chain: ClosedChain, still: State, sizes: Array, step: Array) -> State | None:
    """Return a closed state near a step from a configuration, or near a shorter step; None if there is none.

    A closed state far from there is ignored, because it may belong to another assembly of the chain with another rank.
    """
    for shorter in SHORTER:
        try:
            found = close(chain, moved(still, shorter * step * sizes), limits=False)
        except ClosureError:
            continue
        if np.abs(displacement(still, found) / sizes).max() <= STRAYED * shorter * NEIGHBOUR_DISTANCE:
            return found
    return None


def closed_near(chain: ClosedChain, state: State, inputs: Inputs | None = None) -> State | None:
    """Return the nearest closed state, at which the rank can be determined; None if there is none within 1e-2.

    If the grasps are slightly open, dependent rows have pivots of the order of the gap squared, and seem independent.

    Args:
        chain: the chain.
        state: a state that nearly satisfies the grasps.
        inputs: base motion, if the bases move.
    """
    if not largest_position(chain_at_rest(chain, state), state) <= WIDEST_GAP:
        return None
    try:
        return close(chain, state, limits=False, inputs=inputs)
    except ClosureError:
        return None


def require_trusted(motion: ChainMotion, state: State, found: Pivots) -> None:
    """Refuse a rank from a state with open grasps if it differs from the rank at the nearest closed state.

    Args:
        motion: the chain's motion at the state.
        state: the state.
        found: rank and condition at the state.

    Raises:
        StateError: the ranks differ; the message gives both, and the gap.
    """
    if found.condition * SUSPECT_GAP**2 < 1.0:
        return  # larger gaps are refused or noticed elsewhere
    gap, chain = largest_position(motion, state), motion.chain
    if not may_mislead(found.condition, gap):
        return
    closed = closed_near(chain, state)
    there = found.rank if closed is None else constraint_rank(chain, closed)
    if there != found.rank:
        raise StateError(
            f"the grasps are open by {gap:.3g} (m or rad), too far for the rank of their constraint: {found.rank} of"
            f" {chain.constraint_row_count} here, {there} where they are closed, as some rows follow from others. Try"
            f" holdfast.close(chain, state) first, or generic_rank={there} for states beside the constraint"
        )


def may_mislead(condition: float, gap: float) -> bool:
    """Return whether a gap of the grasps [m or rad] may have made a dependent row seem independent."""
    return gap > CLOSED_GAP and not condition * (ROW_PER_GAP * gap) ** 2 < 1.0


def generic_rank_near(chain: ClosedChain, state: State, here: int) -> int:
    """Return the generic rank of the constraint, from a state at which it has rank `here`.

    The result is here + 1 if no neighbour has a higher rank, but some allowed velocities do not begin a motion.
    """
    found = regularity(chain, state, here)
    return here + 1 if found.kind == "singular" and found.generic_rank == here else found.generic_rank


def held_near(chain: ClosedChain, state: State, generic_rank: int) -> Array | None:
    """Return the mask of constraint rows to impose at a state that nearly satisfies the grasps; see `held_rows`.

    The result is None if all rows are independent, if the grasps cannot be closed, or at a singular configuration.
    """
    if generic_rank >= chain.constraint_row_count:
        return None
    closed = closed_near(chain, state)
    return None if closed is None else _held_at(chain, closed, generic_rank)


def _held_at(chain: ClosedChain, closed: State, rank: int) -> Array | None:
    """Return the mask of constraint rows to impose at a closed state; None if it does not have the given rank."""
    found = sequential(replace(chain_at_rest(chain, closed), generic_rank=rank))
    return found.held if found.rank == rank else None


def rank_and_held_near(chain: ClosedChain, state: State, inputs: Inputs) -> tuple[int, Array | None]:
    """Return the constraint's rank at the nearest closed state, and the mask of rows to impose (None for all)."""
    closed = closed_near(chain, state, inputs) or state
    rank = constraint_rank(chain, closed)
    return rank, _held_at(chain, closed, rank) if rank < chain.constraint_row_count else None


def velocities_are_motions(chain: ClosedChain, state: State) -> bool:
    """Return whether every velocity that the grasps allow begins a motion.

    The function takes a step along each allowed velocity and closes the chain again. At a regular point, a sufficiently
    short step persists. If the rank is deficient to first order only (two arms stretched against each other), closing
    reverses the step, however short it is.
    """
    still, sizes = _still(chain, state)
    basis = motion_basis(chain, state) / sizes[:, None]
    basis, _ = np.linalg.qr(basis)
    if not basis.shape[1]:
        return True  # a structure that cannot move has no velocities to test
    return any(_survive(chain, state, still, sizes, basis, step) for step in TANGENT_STEPS)


def _survive(chain: ClosedChain, state: State, still: State, sizes: Array, basis: Array, step: float) -> bool:
    """Return whether steps of the given length along all directions persist when the chain is closed again."""
    kept = []
    for direction in basis.T:
        there = moved(still, step * sizes * direction)
        try:
            closed = close(chain, there, limits=False)
        except ClosureError:
            return False
        kept.append(basis.T @ (displacement(state, closed) / sizes) / step)
    return bool(np.linalg.svd(np.array(kept), compute_uv=False)[-1] > 0.5)


def _still(chain: ClosedChain, state: State) -> tuple[State, Array]:
    """Return the configuration at rest, and the size of one unit of each coordinate."""
    still = state.at_rest()
    return still, coordinate_sizes(chain_at_rest(chain, still))


def regularity(chain: ClosedChain, state: State, rank: int, generic: int | None = None) -> Regularity:
    """Return the classification of a configuration of the given rank.

    Args:
        chain: the chain.
        state: a closed state.
        rank: its rank.
        generic: the generic rank, if known; an equal rank is then accepted without further checks.
    """
    rows = chain.constraint_row_count
    if rank == rows:
        return Regularity("regular", rank, "")
    if generic is not None:
        if rank < generic:
            return Regularity("singular", generic, f"but {generic} in general")
        return Regularity("indeterminate", generic, "")
    generic = generic_constraint_rank(chain, state)
    if rank < generic:
        return Regularity("singular", generic, f"but {generic} nearby")
    if not velocities_are_motions(chain, state):
        return Regularity("singular", generic, "and some velocities it allows begin no motion")
    return Regularity("indeterminate", generic, "")


def status_at(chain: ClosedChain, state: State, rank: int, generic: int | None = None) -> Status:
    """Return the status at a configuration of the given rank, which states whether the forces are unique.

    Raises:
        SingularChainError: the configuration is singular.
    """
    found = regularity(chain, state, rank, generic)
    if found.kind == "singular":
        raise SingularChainError(
            f"the grasp constraint has rank {rank} of {chain.constraint_row_count} here, {found.why}: a singular"
            " configuration, where forces and accelerations are not those of any trajectory. holdfast.diagnose names"
            " the lost directions; try another configuration or another grasp"
        )
    return Status.OK if found.kind == "regular" else Status.INDETERMINATE_FORCES
