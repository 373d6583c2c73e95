"""What a status means: the generic rank found when it first matters, and errors with a reason."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from holdfast.compiled.forward_schedule import GUARDED
from holdfast.compiled.result import INDETERMINATE, INVALID, SINGULAR, UNDECIDED, CompiledResult
from holdfast.compiler.trigonometry import LARGEST_ARGUMENT
from holdfast.dynamics import rank
from holdfast.errors import HoldfastError, ModelError, StateError
from holdfast.model.checks import ROTATION_TOLERANCE
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.state import State

if TYPE_CHECKING:
    from holdfast.compiled.chain import CompiledChain


def settle(compiled: CompiledChain, found: Mapping[str, Array], result: CompiledResult) -> None:
    """Decide the statuses that machine code left open, for want of the generic rank."""
    status, ranks = np.atleast_1d(result.array("status")), np.atleast_1d(result.array("rank"))
    open_ = np.flatnonzero(status == UNDECIDED)
    if not open_.size:
        return
    if compiled.generic_rank is None:
        compiled.know_rank(generic_rank(compiled.chain, state_of(found, int(open_[0])), int(ranks[open_[0]])))
    assert compiled.generic_rank is not None
    singular = open_[ranks[open_] < compiled.generic_rank]
    status[open_] = INDETERMINATE
    status[singular] = SINGULAR
    if singular.size:
        for name in GUARDED:
            x = result.array(name)
            (x if result.batch is not None else x[None])[singular] = np.nan


def generic_rank(chain: ClosedChain, state: State, found: int) -> int:
    """Return the rank that a chain has in general, given a state where it is low."""
    verdict = rank.regularity(chain, state, found)
    if verdict.kind == "singular" and verdict.generic_rank == found:
        return found + 1  # no neighbour has more, but some velocities begin no motion
    return verdict.generic_rank


def state_of(found: Mapping[str, Array], row: int) -> State:
    """Return the state of one system of a batch (or the one that all share)."""
    shapes = {"q": 1, "qd": 1, "object_pose": 1, "object_twist": 1}
    return State(*(found[name][row] if found[name].ndim > n else found[name] for name, n in shapes.items()))


def require_answer(compiled: CompiledChain, found: Mapping[str, Array], result: CompiledResult) -> None:
    """Raise what the reference raises where there is no answer.

    Raises:
        SingularChainError, StateError, ModelError: saying why.
    """
    status = int(result.array("status"))
    if status == SINGULAR:
        rank.verdict(compiled.chain, state_of(found, 0), result.rank, compiled.generic_rank)
    if status == INVALID:
        raise reason(found)


def reason(found: Mapping[str, Array]) -> HoldfastError:
    """Return why one system's results are not finite."""
    for name, x in found.items():
        if not np.isfinite(x).all():
            return StateError(f"{name}: expected finite numbers, got {x[~np.isfinite(x)][0]}")
    length = float(np.linalg.norm(found["object_pose"][:4]))
    if abs(length - 1.0) > ROTATION_TOLERANCE:
        return StateError(f"object_pose: expected a unit quaternion (w, x, y, z) first, got length {length:.9g}")
    if np.abs(found["q"]).max() > LARGEST_ARGUMENT:
        return StateError(f"q: expected at most {LARGEST_ARGUMENT:g} rad, got {np.abs(found['q']).max():.6g}")
    return ModelError(
        "the accelerations are not finite: an arm's mass matrix is singular here, or sizes overflow; holdfast."
        "forward_dynamics on the same state names the arm and the joint"
    )
