"""Rank of the grasp constraint here, and in general (docs/theory/singular.md).

Generic rank is the largest rank over a few closed neighbours. Rank = generic but deficient:
the forces are indeterminate everywhere, the accelerations are right. Rank < generic: this
configuration is singular, and the pointwise answer is not the trajectory's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_at_rest
from holdfast.dynamics.closed.rest_response import rest_response
from holdfast.dynamics.closed.sequential import sequential
from holdfast.dynamics.closing import close
from holdfast.dynamics.consistency import GraspResidual, residuals
from holdfast.dynamics.constraint import coordinate_sizes
from holdfast.dynamics.object_level import motion_basis
from holdfast.dynamics.projection import CLOSED, FARTHEST, moved
from holdfast.dynamics.result import Status
from holdfast.errors import ClosureError, SingularChainError, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State

NEIGHBOURS = 8
NEIGHBOUR_DISTANCE = 0.1  # rad, or part of the arms' reach
SHORTER = (1.0, 0.25, 0.0625)  # parts of it, where a neighbour is not as near
STRAYED = 3.0  # times as far: what closes there is no neighbour
TANGENT_STEPS = (0.05, 0.005, 0.0005)  # the same: near a singular configuration only short ones lead on
# A row that follows from others has a relative pivot of about gap^2 beside the constraint, gap in m or rad. What is
# larger than that by far is no such row.
ROW_PER_GAP = 100.0  # root of the relative pivot, over the gap
SUSPECT_GAP = 1e-1  # root of the largest relative pivot worth asking about


class Regularity(NamedTuple):
    """How a configuration stands to its neighbours.

    Attributes:
        kind: "regular" (full rank), "indeterminate" (rank constantly low) or "singular".
        generic_rank: the rank nearby.
        why: for a singular one, what gives it away.
    """

    kind: Literal["regular", "indeterminate", "singular"]
    generic_rank: int
    why: str


class Pivots(NamedTuple):
    """What the pivots of the object filter tell about the grasp constraint at a configuration.

    Attributes:
        rank: how many are kept.
        condition: inverse of the smallest kept, relative to its scale, as in `ForwardResult`.
    """

    rank: int
    condition: float


@np.errstate(all="ignore")  # what overflows is refused
def constraint_pivots(chain: ClosedChain, state: State) -> Pivots:
    """Return rank and condition of [J, -A, H^T] at a configuration, as forward dynamics finds them.

    Raises:
        StateError: they overflow.
    """
    found = rest_response(chain_at_rest(chain, state))
    checks.finite(np.append(found.object_acceleration, found.weakest_pivot), "the rank of the constraint")
    return Pivots(int(found.rank), 1.0 / float(found.weakest_pivot))


def constraint_rank(chain: ClosedChain, state: State) -> int:
    """Return the rank of [J, -A, H^T] at a configuration."""
    return constraint_pivots(chain, state).rank


def generic_constraint_rank(chain: ClosedChain, state: State) -> int:
    """Return the largest rank over 8 seeded closed neighbours about 0.1 rad away.

    A structure without closable neighbours is locked: its own rank is returned.
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
    """Return a closed state near a step from a configuration, or near a shorter one; None if there is none.

    What closes only far from there may be another assembly of the chain, whose rank says nothing about this one.
    """
    for shorter in SHORTER:
        try:
            found = close(chain, moved(still, shorter * step * sizes), limits=False)
        except ClosureError:
            continue
        if np.abs(_moved_by(still, found) / sizes).max() <= STRAYED * shorter * NEIGHBOUR_DISTANCE:
            return found
    return None


def closed_near(chain: ClosedChain, state: State, inputs: Inputs | None = None) -> State | None:
    """Return the nearest closed state: where a rank means something. None if there is none within 1e-2.

    A little off the grasps a row that follows from others has a pivot of the order of the gap's square.

    Args:
        chain: the chain.
        state: near the grasps.
        inputs: base motion, if the bases move.
    """
    if not _largest_gap(residuals(chain_at_rest(chain, state), state)) <= FARTHEST:
        return None
    try:
        return close(chain, state, limits=False, inputs=inputs)
    except ClosureError:
        return None


def require_trusted(motion: ChainMotion, state: State, found: Pivots) -> None:
    """Refuse a rank that was found beside the constraint, if it is another on it.

    Args:
        motion: the chain there.
        state: where it was found.
        found: what was found.

    Raises:
        StateError: saying how far off the state is, and both ranks.
    """
    if found.condition * SUSPECT_GAP**2 < 1.0:
        return  # a gap that could do this is refused, or seen, elsewhere
    gap, chain = _largest_gap(residuals(motion, state)), motion.chain
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
    """Return whether a gap of the grasps [m or rad] may have made a row seem independent that follows from others."""
    return gap > CLOSED and not condition * (ROW_PER_GAP * gap) ** 2 < 1.0


def _largest_gap(gaps: Mapping[str, GraspResidual]) -> float:
    """Return the largest position gap of any grasp [m or rad]."""
    return max((float(np.abs(gap.position).max(initial=0.0)) for gap in gaps.values()), default=0.0)


def generic_rank_near(chain: ClosedChain, state: State, here: int) -> int:
    """Return the rank that the constraint has in general, from a state where it has rank `here`.

    One more than that if no neighbour has more, and yet some velocities begin no motion.
    """
    found = regularity(chain, state, here)
    return here + 1 if found.kind == "singular" and found.generic_rank == here else found.generic_rank


def held_near(chain: ClosedChain, state: State, generic_rank: int) -> Array | None:
    """Return which components of the grasps to hold at a state that nearly closes them; see `held_rows`.

    None where no row follows from others, where the grasps do not close, or at a singular configuration.
    """
    if generic_rank >= chain.constraint_row_count:
        return None
    closed = closed_near(chain, state)
    return None if closed is None else _held_at(chain, closed, generic_rank)


def _held_at(chain: ClosedChain, closed: State, rank: int) -> Array | None:
    """Return which components of the grasps to hold at a closed state; None if it has not that rank."""
    found = sequential(replace(chain_at_rest(chain, closed), generic_rank=rank))
    return found.held if found.rank == rank else None


def rank_and_held_near(chain: ClosedChain, state: State, inputs: Inputs) -> tuple[int, Array | None]:
    """Return the constraint's rank at the nearest closed state, and which components to hold; None: all of them."""
    closed = closed_near(chain, state, inputs) or state
    rank = constraint_rank(chain, closed)
    return rank, _held_at(chain, closed, rank) if rank < chain.constraint_row_count else None


def velocities_are_motions(chain: ClosedChain, state: State) -> bool:
    """Return whether every velocity that the grasps allow begins a motion.

    Steps along each allowed velocity and closes the chain again: at a regular point the
    step survives, if it is short enough; where the rank is low only to first order (two arms
    stretched against each other) it is taken back, however short.
    """
    still, sizes = _still(chain, state)
    basis = motion_basis(chain, state) / sizes[:, None]
    basis, _ = np.linalg.qr(basis)
    if not basis.shape[1]:
        return True  # a locked structure has no velocities to test
    return any(_survive(chain, state, still, sizes, basis, step) for step in TANGENT_STEPS)


def _survive(chain: ClosedChain, state: State, still: State, sizes: Array, basis: Array, step: float) -> bool:
    """Return whether steps of a length along all directions survive closing."""
    kept = []
    for direction in basis.T:
        there = moved(still, step * sizes * direction)
        try:
            closed = close(chain, there, limits=False)
        except ClosureError:
            return False
        kept.append(basis.T @ (_moved_by(state, closed) / sizes) / step)
    return bool(np.linalg.svd(np.array(kept), compute_uv=False)[-1] > 0.5)


def _moved_by(before: State, after: State) -> Array:
    """Return the way from one state to another in the columns of `ConstraintRows.matrix`."""
    frames = [(before.object_frame, after.object_frame), (before.base_frame, after.base_frame)]
    turns = [_displacement(a, b) for a, b in frames if a is not None and b is not None]
    return np.concatenate([after.q - before.q, *turns])


def _displacement(a: Pose, b: Pose) -> Array:
    """Return the [turn; shift] from one pose to another, (6,) world axes."""
    return np.concatenate([rotation.log(b.R @ a.R.T), b.p - a.p])


def _still(chain: ClosedChain, state: State) -> tuple[State, Array]:
    """Return the configuration at rest, and the size of one unit of each coordinate."""
    still = state.at_rest()
    return still, coordinate_sizes(chain_at_rest(chain, still))


def regularity(chain: ClosedChain, state: State, rank: int, generic: int | None = None) -> Regularity:
    """Return how a configuration of the given rank stands to its neighbours.

    Args:
        chain: the chain.
        state: a closed state.
        rank: its rank.
        generic: the generic rank, if known; a rank equal to it is then trusted.
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
    """Return whether forces are unique at a configuration of the given rank.

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
