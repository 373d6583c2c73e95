"""The schedule of forward dynamics, made by tracing the reference's functions."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

from holdfast.compiled.computation import Computation
from holdfast.compiled.structure import Options, Structure
from holdfast.compiled.traced_chain import Given, externals, traced, traced_chain, traced_inputs, traced_state
from holdfast.compiler.schedule import External, Schedule
from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution, chain_motion
from holdfast.dynamics.closed.chain_solution import ChainSolution, chain_solution
from holdfast.dynamics.closed.forward_derivatives import known_beforehand
from holdfast.dynamics.closed.held_rows import holding
from holdfast.dynamics.closed.sequential import sequential, tips_of
from holdfast.dynamics.closed.tip_response import Route
from holdfast.dynamics.contact.pressing import Pressing, pressing
from holdfast.dynamics.contact.touching_chain import mobility_found, pushed, with_push
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.world.touching import Touching
from holdfast.questions.arrays import (
    BASE_MOTION,
    FLOATING,
    RESULTS,
    STATE_AND_TORQUES,
    TOUCH_RESULTS,
    TOUCH_START,
    TRUNK_BASE_MOTION,
    Shape,
    link_parameters,
    shapes,
)
from holdfast.spatial.scalar import Array, Scalar, where
from holdfast.state import Inputs, State

DOUBTFUL = 1e-6  # a constraint row with a smaller pivot may be dependent, if the state violates the constraint


def guarded_outputs(chain: ClosedChain) -> tuple[str, ...]:
    """Return the outputs that are NaN if there is no solution."""
    of_trunk = [] if chain.trunk is None else ["trunk_base_wrench"]
    return *RESULTS, *of_trunk, *(["floating_acceleration"] if chain.floats else [])


def forward_computation(chain: ClosedChain, options: Options) -> Computation:
    """Return the computation of forward dynamics."""
    structure = Structure(chain, options)
    return Computation(
        "forward",
        structure,
        forward_externals(structure),
        lambda: forward_schedule(structure),
        STATE_AND_TORQUES,
        _by_name(structure),
    )


def forward_externals(structure: Structure) -> dict[str, External]:
    """Return the arrays of compiled forward dynamics: inputs, parameters, results."""
    chain, options = structure.chain, structure.options
    # The inputs of a call without parameters come first, because the builtin fills in the first addresses.
    inputs = [*STATE_AND_TORQUES, *_by_name(structure), "object_wrench"]
    parameters = ["gravity", "generic_rank", "object_mass", "object_com", "object_inertia"]
    moving = [*BASE_MOTION, *(TRUNK_BASE_MOTION if chain.trunk is not None and not chain.floats else ())]
    # The positions of the bases matter only with a trunk, with springs, or with sliding grasps.
    slides = any(grasp.of_kind.slides for grasp in chain.grasps.values())
    parameters += ["base_R", *(moving if options.base_motion else ()), "grasp_R", "grasp_p"]
    parameters += ["base_p"] if slides or chain.springs or chain.trunk is not None else []
    if options.link_wrenches:
        inputs += ["link_wrench", *(["trunk_link_wrench"] if chain.trunk is not None else ())]
    if options.link_inertia:
        parameters += link_parameters(chain)
    of_status: dict[str, Shape] = {"generic_rank": (), "rank": (), "status": (), "condition": ()}
    outputs = (*guarded_outputs(chain), "rank", "status", "condition")
    if chain.touching is not None:
        outputs = (*outputs, *TOUCH_RESULTS)
    return externals(inputs, parameters, outputs, shapes(chain) | of_status)


def _by_name(structure: Structure) -> tuple[str, ...]:
    """Return the names of the inputs that a call gives by name: of a floating base, and forces to begin with."""
    further = structure.options.further
    return *(FLOATING if structure.chain.floats else ()), *(name for name in further if name == TOUCH_START)


def forward_schedule(structure: Structure) -> Schedule:
    """Return the schedule of one chain's forward dynamics."""
    externals = forward_externals(structure)
    guarded = tuple(name for name in guarded_outputs(structure.chain) if externals[name].size)
    return traced(externals, lambda given: forward(structure, given), "status", guarded)


def forward(structure: Structure, given: Given) -> dict[str, Any]:
    """Return the outputs of forward dynamics by running the reference's functions on traced arrays."""
    chain, touching = traced_chain(structure, given), structure.chain.touching
    state, inputs = traced_state(chain, given), traced_inputs(chain, given)
    route = structure.options.route
    found = solve_with_status(chain, state, given["tau"], inputs, given["generic_rank"], route)
    if touching is None:
        return outputs_of(chain, found)
    found, of_world = touched(found, touching, state, route, given.get(TOUCH_START))
    return outputs_of(chain, found) | {name: getattr(of_world, name) for name in TOUCH_RESULTS}


def touched(
    free: SolutionWithStatus, touching: Touching, state: State, route: Route, start: Array | None
) -> tuple[SolutionWithStatus, Pressing]:
    """Return the solution with the forces of the world on the object, and these.

    The status is 4 where there are none that satisfy the laws of contact.

    Args:
        free: the solution without them.
        touching: the points and shapes.
        state: positions and velocities.
        route: how the inverse inertia at each arm's tip is computed.
        start: (k, 3) forces of a similar problem; see `pressing`.
    """
    motion = free.motion
    tips = tips_of(motion, route)
    found = pressing(touching, state, mobility_found(motion, free.found, tips), free.whole.object_acceleration, start)
    loaded = pushed(motion, state, found.wrench)
    solution = with_push(loaded, free.found, tips, found.wrench)
    lawful = where(found.touch_status + found.approaches > 0.0, 0.0, 1.0) > 0.0
    status = where(lawful, free.status, where(free.status > 0.0, free.status, 4.0))
    whole = chain_solution(loaded, solution, route)
    return free._replace(whole=whole, status=status, motion=loaded, found=solution), found


def outputs_of(chain: ClosedChain, found: SolutionWithStatus) -> dict[str, Any]:
    """Return the outputs of forward dynamics by their names."""
    fields = {"floating_acceleration": "base_acceleration"}
    outputs = {name: getattr(found.whole, fields.get(name, name)) for name in guarded_outputs(chain)}
    return outputs | {name: getattr(found, name) for name in ("rank", "status", "condition")}


class SolutionWithStatus(NamedTuple):
    """The solution of forward dynamics and its status.

    Attributes:
        whole: accelerations and forces.
        rank: the number of independent rows of the constraint.
        status: the status, numbered as in `status_of_rank`.
        condition: the reciprocal of the constraint's smallest pivot.
        held: which components of the grasps are held, if the algorithm has chosen them; otherwise None.
        motion: the kinematics and bias terms of the chain.
        found: the solution of `sequential`.
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
    there: ChainMotion | None = None,
) -> SolutionWithStatus:
    """Return forward dynamics by `sequential`, and its status.

    Args:
        chain: the chain.
        state: positions and velocities.
        tau: (n,) joint torques.
        inputs: shaped inputs.
        generic_rank: () the generic rank of the constraint, or -1 if it is unknown.
        route: how the inverse inertia at each arm's tip is computed.
        held: which components of the grasps may be held; None for all.
        choose: whether to hold only the components with the largest pivots, as many as the generic rank.
        cotangents: the cotangents of a later gradient, so that both solves share one pass of the filter.
        there: a motion at the same positions, if one is known; see `chain_motion`.
    """
    motion = holding(chain_motion(chain, state, tau, inputs, there), held)
    if choose:
        motion = replace(motion, generic_rank=generic_rank[()])
    second = None if cotangents is None else known_beforehand(motion, cotangents)
    found = sequential(motion, route, second)
    status = status_of_rank(found.rank, generic_rank[()], chain.constraint_row_count, found.weakest_pivot)
    whole = chain_solution(motion, found, route)
    return SolutionWithStatus(whole, found.rank, status, 1.0 / found.weakest_pivot, found.held, motion, found)


def status_of_rank(rank: Scalar, generic_rank: Scalar, row_count: int, weakest_pivot: Scalar) -> Scalar:
    """Return the status of a rank, numbered as in `compiled.result`.

    0: the solution is unique. 1: the rank is low in every configuration, so forces are not unique. 2: undecided; the
    generic rank is unknown (-1), and the rank is low or depends on a pivot that may be due to a constraint violation.
    3: the rank is below the generic rank, so the configuration is singular. 4: the rank is above the generic rank,
    which happens only if the state violates the constraint.
    """
    full = float(row_count)
    known = where(rank < generic_rank, 3.0, where(rank > generic_rank, 4.0, where(rank < full, 1.0, 0.0)))
    unknown = where(rank < full, 2.0, where(weakest_pivot < DOUBTFUL, 2.0, 0.0))
    return where(generic_rank < 0.0, unknown, known)
