"""Resolve statuses that machine code leaves undecided, and turn bad statuses into errors with a reason."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from holdfast.compiled.arrays import input_error, largest_positions
from holdfast.compiled.derivative_schedule import FOUND
from holdfast.compiled.result import INDETERMINATE, INVALID, OK, SINGULAR, UNDECIDED, Results
from holdfast.dynamics import rank
from holdfast.dynamics.closed.chain_motion import chain_at_rest
from holdfast.dynamics.contact.rows import contact_rows
from holdfast.dynamics.contact.solved_contacts import ContactStatus
from holdfast.dynamics.contact.touching_chain import require_no_approach
from holdfast.errors import ContactError, ModelError, StateError
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import TOUCH_START, results_of, state_fields
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.state import State

_ALWAYS = {"rank", "status", "condition"}  # results that are valid for every status
MOST_TRIED = 16  # how many undecided systems are searched for one that satisfies the constraint

NOT_UNIQUE = ("grasp_wrench", "base_wrench")  # results that are not unique if the constraint's rank is low

if TYPE_CHECKING:
    from holdfast.compiled.chain import CompiledChain
    from holdfast.compiled.function import Function


def settle(function: Function, found: Mapping[str, Array], result: Results) -> None:
    """Resolve undecided statuses, and refuse one system without a solution.

    Derivatives of forces that are not unique are refused; in a batch they become NaN.
    """
    compiled, request = function.compiled, function.request
    resolve_undecided(compiled, found, result)
    if result.batch is None:
        require_answer(compiled, found, result)
    choices = [] if request is None else [name for name in request.results if name in NOT_UNIQUE]
    low = np.atleast_1d(result.array("status")) == INDETERMINATE
    if request is None or not low.any() or not choices:
        return
    if result.batch is None:
        others = ", ".join(name for name in results_of(result.chain) if name not in NOT_UNIQUE)
        raise StateError(
            f"{choices[0]}: the forces are not unique here, and machine code finds one choice among them, whose"
            f" derivative means nothing; try those of {others}"
        )
    for name in request.found(result.chain):
        if request.kind == "vjp" or name.partition(".")[0] in choices:
            result.array(f"{FOUND}{name}")[low] = np.nan


def resolve_undecided(compiled: CompiledChain, found: Mapping[str, Array], result: Results) -> None:
    """Resolve the statuses that machine code left undecided because the generic rank was unknown.

    The generic rank is determined near the first undecided system that nearly satisfies the grasp constraint, and is
    then stored. If no system does, the rank near the first undecided system is used for this call only.
    """
    status, ranks = np.atleast_1d(result.array("status")), np.atleast_1d(result.array("rank"))
    open_ = np.flatnonzero(status == UNDECIDED)
    if not open_.size:
        return
    generic = compiled.generic_rank
    if generic is None:
        tried = [system(compiled.chain, found, row) for row in open_[:MOST_TRIED].tolist()]
        with np.errstate(all="ignore"):
            near = ((chain, rank.closed_near(chain, state)) for chain, state in tried)
            closed = next(((chain, there) for chain, there in near if there is not None), None)
        if closed is None:
            generic = rank.generic_rank_near(*tried[0], int(ranks[open_[0]]))
        else:
            generic = rank.generic_rank_near(*closed, rank.constraint_rank(*closed))
            compiled.set_generic_rank(generic)
    of = ranks[open_]
    status[open_] = OK if generic == compiled.chain.constraint_row_count else INDETERMINATE
    status[open_[of < generic]] = SINGULAR
    status[open_[of > generic]] = INVALID
    without = open_[of != generic]
    for name in set(result.layout.shapes) - _ALWAYS if without.size else ():
        x = result.array(name)
        (x if result.batch is not None else x[None])[without] = np.nan


def system(chain: ClosedChain, found: Mapping[str, Array], row: int) -> tuple[ClosedChain, State]:
    """Return the chain, with its own bases and grasp frames, and the state of one system of a batch."""

    def of(name: str, axes: int) -> Array:
        return found[name][row] if found[name].ndim > axes else found[name]

    state = State(**{field: of(name, 1) for name, field in state_fields(chain).items()})
    if "base_p" in found:
        poses = zip(chain.names, of("base_R", 3), of("base_p", 2), strict=True)
        chain = chain.with_bases({name: Pose.unchecked(R, p) for name, R, p in poses})
    frames = zip(chain.grasps, of("grasp_R", 3), of("grasp_p", 2), strict=True)
    grasps = {name: replace(chain.grasps[name], frame=Pose.unchecked(R, p)) for name, R, p in frames}
    return replace(chain, grasps=grasps), state


def require_answer(compiled: CompiledChain, found: Mapping[str, Array], result: Results) -> None:
    """Raise the error that the reference would raise if one system has no solution.

    Raises:
        SingularChainError: The configuration is singular.
        StateError: An input is invalid, or the state violates the constraint.
        ModelError: The accelerations are not finite.
    """
    status = int(result.array("status"))
    if status == SINGULAR:
        rank.status_at(*system(compiled.chain, found, 0), int(result.array("rank")), compiled.generic_rank)
    if status == INVALID:
        if compiled.generic_rank is not None and result.array("rank") > compiled.generic_rank:
            chain, state = system(compiled.chain, found, 0)
            rank.require_trusted(chain_at_rest(chain, state), state, rank.Pivots(int(result.array("rank")), np.inf))
        if wrong := input_error(found, largest_positions(compiled.chain)):
            raise wrong
        _require_contacts(compiled, found, result)
        raise ModelError(
            "the accelerations are not finite: an arm's mass matrix is singular here, or sizes overflow; holdfast."
            "forward_dynamics on the same state names the arm and the joint"
        )


def _require_contacts(compiled: CompiledChain, found: Mapping[str, Array], result: Results) -> None:
    """Raise the error of contacts with the world without forces, if that is why one system has no solution.

    Raises:
        StateError: A closed contact approaches.
        ContactError: No forces were found that satisfy the laws of contact.
    """
    if compiled.chain.touching is None or not np.isfinite(result.array("touch_gap")).all():
        return
    _, state = system(compiled.chain, found, 0)
    rows = contact_rows(compiled.chain.touching, state.object_frame, state.object_twist)
    require_no_approach(compiled.chain.touching, rows, state.object_twist)
    if result.array("touch_status") > 0.0:
        residual = float(result.array("touch_residual"))
        raise ContactError(
            f"contacts: the fixed number of steps found no forces that satisfy Coulomb's law to 1e-9 of the"
            f" accelerations: the best ones violate it by {residual:.1e}; holdfast.forward_dynamics tries slower ways"
            + (", and a call without touch_start tries more steps" if TOUCH_START in found else ""),
            ContactStatus.UNRESOLVED.name,
        )
