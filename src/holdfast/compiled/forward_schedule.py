"""Forward dynamics as a schedule: the reference's own functions, traced."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

from holdfast.compiled.externals import BASE_MOTION, FLOATING, LINKS, TRUNK_BASE_MOTION, externals, shapes
from holdfast.compiled.structure import Structure
from holdfast.compiled.traced_chain import Given, traced, traced_chain, traced_inputs, traced_state
from holdfast.compiler.program import Shape
from holdfast.compiler.schedule import External, Schedule
from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution, chain_motion
from holdfast.dynamics.closed.chain_solution import ChainSolution, chain_solution
from holdfast.dynamics.closed.forward_derivatives import known_beforehand
from holdfast.dynamics.closed.held_rows import holding
from holdfast.dynamics.closed.sequential import sequential
from holdfast.dynamics.closed.tip_response import Route
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array, Scalar, where
from holdfast.state import Inputs, State

DOUBTFUL = 1e-6  # pivot of a row that may follow from others, in a state beside the grasps
GUARDED = ("qdd", "grasp_wrench", "object_acceleration", "contact_acceleration", "base_wrench")


def guarded_outputs(chain: ClosedChain) -> tuple[str, ...]:
    """Return the outputs that are not-a-number where there is no answer."""
    of_trunk = [] if chain.trunk is None else ["trunk_base_wrench"]
    return *GUARDED, *of_trunk, *(["floating_acceleration"] if chain.floats else [])


def forward_externals(structure: Structure) -> dict[str, External]:
    """Return the arrays of compiled forward dynamics: inputs, parameters, results."""
    chain, options = structure.chain, structure.options
    # first those of a call without parameters, as a builtin fills them in
    inputs = ["q", "qd", "tau", "object_pose", "object_twist", *(FLOATING if chain.floats else ()), "object_wrench"]
    parameters = ["gravity", "generic_rank", "object_mass", "object_com", "object_inertia"]
    moving = [*BASE_MOTION, *(TRUNK_BASE_MOTION if chain.trunk is not None and not chain.floats else ())]
    # on a trunk the origins of the bases matter too, and where springs are or wrenches are about the tips
    slides = any(grasp.of_kind.slides for grasp in chain.grasps.values())
    parameters += ["base_R", *(moving if options.base_motion else ()), "grasp_R", "grasp_p"]
    parameters += ["base_p"] if slides or chain.springs or chain.trunk is not None else []
    if options.link_wrenches:
        inputs += ["link_wrench", *(["trunk_link_wrench"] if chain.trunk is not None else ())]
    if options.link_inertia:
        parameters += LINKS
    of_status: dict[str, Shape] = {"generic_rank": (), "rank": (), "status": (), "condition": ()}
    outputs = (*guarded_outputs(chain), "rank", "status", "condition")
    return externals(inputs, parameters, outputs, shapes(chain) | of_status)


def forward_schedule(structure: Structure) -> Schedule:
    """Return the schedule of one chain's forward dynamics."""
    externals = forward_externals(structure)
    guarded = tuple(name for name in guarded_outputs(structure.chain) if externals[name].size)
    return traced(externals, lambda given: forward(structure, given), "status", guarded)


def forward(structure: Structure, given: Given) -> dict[str, Any]:
    """Return the outputs of forward dynamics: the reference's functions, run on what is given."""
    chain = traced_chain(structure, given)
    state, inputs = traced_state(chain, given), traced_inputs(chain, given)
    found = solve_with_status(chain, state, given["tau"], inputs, given["generic_rank"], structure.options.route)
    return outputs_of(chain, found)


def outputs_of(chain: ClosedChain, found: SolutionWithStatus) -> dict[str, Any]:
    """Return the outputs of forward dynamics by their names."""
    outputs = {name: getattr(found.whole, name) for name in GUARDED}
    if chain.trunk is not None:
        outputs["trunk_base_wrench"] = found.whole.trunk_base_wrench
    if chain.floats:
        outputs["floating_acceleration"] = found.whole.base_acceleration
    return outputs | {name: getattr(found, name) for name in ("rank", "status", "condition")}


class SolutionWithStatus(NamedTuple):
    """Forward dynamics and how it is to be read.

    Attributes:
        whole: accelerations and forces.
        rank: independent rows of the constraint.
        status: as `status_of_rank` numbers them.
        condition: of the constraint.
        held: which components of the grasps are held, where they are chosen.
        motion: the chain in motion.
        found: what `sequential` found.
    """

    whole: ChainSolution
    rank: Scalar
    status: Scalar
    condition: Scalar
    held: Array | None
    motion: ChainMotion
    found: Solution


def solve_with_status(
    chain: ClosedChain,
    state: State,
    tau: Array,
    inputs: Inputs,
    generic_rank: Array,
    route: Route,
    held: Array | None = None,
    choose: bool = False,
    cotangents: Given | None = None,
) -> SolutionWithStatus:
    """Return forward dynamics by `sequential`, and its status.

    Args:
        chain: the chain.
        state: positions and velocities.
        tau: (n,) joint torques.
        inputs: shaped inputs.
        generic_rank: () of the constraint, -1 if it is not known.
        route: how each arm answers at its tip.
        held: which components of the grasps may be held; None: all.
        choose: hold the strongest of them, as many as the generic rank says.
        cotangents: what gradients will be taken with, for one way through the filter.
    """
    motion = holding(chain_motion(chain, state, tau, inputs), held)
    if choose:
        motion = replace(motion, generic_rank=generic_rank[()])
    second = None if cotangents is None else known_beforehand(motion, cotangents)
    found = sequential(motion, route, second)
    status = status_of_rank(found.rank, generic_rank[()], chain.constraint_row_count, found.weakest_pivot)
    whole = chain_solution(motion, found, route)
    return SolutionWithStatus(whole, found.rank, status, 1.0 / found.weakest_pivot, found.held, motion, found)


def status_of_rank(rank: Scalar, generic_rank: Scalar, row_count: int, weakest_pivot: Scalar) -> Scalar:
    """Return the status of a rank, as `compiled.result` numbers them.

    0: all is unique. 1: the rank is constantly low. 2: it is low, or full by a pivot that a gap of the
    grasps might have made, and the generic rank is not known (given as -1). 3: it is lower than in general,
    a singular configuration. 4: it is higher than in general, as it can be off the grasps only.
    """
    full = float(row_count)
    known = where(rank < generic_rank, 3.0, where(rank > generic_rank, 4.0, where(rank < full, 1.0, 0.0)))
    unknown = where(rank < full, 2.0, where(weakest_pivot < DOUBTFUL, 2.0, 0.0))
    return where(generic_rank < 0.0, unknown, known)
