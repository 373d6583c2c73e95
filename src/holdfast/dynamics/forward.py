"""Forward dynamics of a closed chain, by any of the algorithms in `METHODS`."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics import rank
from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution, chain_motion, pseudo_gravity
from holdfast.dynamics.closed.chain_solution import chain_solution
from holdfast.dynamics.closed.general import FreeDynamics
from holdfast.dynamics.closed.held_rows import holding
from holdfast.dynamics.closed.sequential import sequential
from holdfast.dynamics.closed.tip_response import LEAST_INERTIA, Route
from holdfast.dynamics.consistency import require_closed
from holdfast.dynamics.contact.touching_chain import TouchingForces, pushed, require_resolved, touching_forces
from holdfast.dynamics.methods import Method, method_named
from holdfast.dynamics.result import ForwardResult, Status
from holdfast.dynamics.smallest_forces import with_smallest_forces
from holdfast.dynamics.tree.mechanism import mechanism_dynamics
from holdfast.errors import MethodNotApplicable, ModelError, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.serial_chain import answered_as_forest, require_unused
from holdfast.questions.arrays import (
    ARGUMENTS,
    ARRAYS,
    BASE_RESULT,
    FLOATING,
    FLOATING_RESULT,
    OBJECT,
    RESULTS,
    STATE_AND_TORQUES,
    TRUNK_BASE_MOTION,
    TRUNK_LINKS,
    results_of,
)
from holdfast.questions.case import VariedCase
from holdfast.questions.derivatives import asked, declare
from holdfast.questions.question import Question
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State, require_fit, shaped_inputs


@asked
@np.errstate(all="ignore")  # what overflows is refused below
def forward_dynamics(
    chain: ClosedChain,
    state: State,
    tau: ArrayLike,
    *,
    inputs: Inputs | None = None,
    method: str | FreeDynamics = "sequential",
    route: Route = "auto",
    check: bool = True,
    generic_rank: int | None = None,
    held: Array | None = None,
) -> ForwardResult:
    """Return the joint accelerations, the wrench at every grasp and the object's acceleration.

    Solves M qdd + C + J^T f = T and M(C) alpha(C) + b(C) = A^T f subject to the grasp constraints, (2.10) for rigid
    grasps and (b.1) for all kinds. The cost is O(n) + O(l) by `sequential`; `METHODS` lists that of the others.

    Args:
        chain: arms, object and grasps.
        state: positions and velocities, which must satisfy the grasps.
        tau: (n,) joint torques, arms in order, base to tip [N m or N].
        inputs: external wrenches and base motion; zero by default.
        method: an algorithm's name (`holdfast methods` lists them), or a function
            `(ArmMotion, torque, tip_wrench) -> qdd` for the forward dynamics of one arm, which (4.9) then uses.
        route: how `sequential` finds each arm's response: "recursive", "mass_matrix" or "auto".
        check: if False, the residuals of the grasps are not checked (integrators project instead).
        generic_rank: rank of the constraint away from singular configurations, if known.
        held: mask of the constraint rows to keep, from the result at a nearby state (`ForwardResult.held`). It is
            needed if some rows are dependent and the state is slightly off the constraint manifold, where their
            rank cannot be determined.

    Returns:
        A `ForwardResult`; for a chain with branches, loops, couplings or several objects a `MechanismResult`, by the
        methods "sequential" and "kkt".

    Raises:
        StateError: if a shape is wrong, the state violates a grasp, or the state is so far off the constraint
            manifold that the rank there differs from that at the nearest closed state.
        SingularChainError: if the configuration is singular, so that the constraint's rank drops.
        MethodNotApplicable: if the chosen algorithm does not cover this chain.
        ContactError: if no forces of the world on the object satisfy the laws of contact, or none were found.
    """
    if answered_as_forest(chain):
        require_unused(route=route != "auto", generic_rank=generic_rank is not None, held=held is not None)
        return mechanism_dynamics(chain, state, tau, inputs, method, check=check)  # pyright: ignore[reportReturnType]
    require_fit(chain, state)
    tau = checks.numbers(tau, (chain.joint_count,), "tau", StateError)
    given = shaped_inputs(chain, inputs)
    motion = chain_motion(chain, state, tau, given)
    if check:
        require_closed(motion, state)
    chosen = method_named(method)
    if route not in get_args(Route):
        raise MethodNotApplicable(f"no route {route!r}.{checks.did_you_mean(str(route), get_args(Route))}")
    if chain.trunk is not None and not chosen.takes_trunk:
        raise MethodNotApplicable(
            f"{chosen.name}: the paper's arms stand on bases of their own, but the chain has a trunk; try"
            " method='sequential' or 'kkt'"
        )
    if chosen.rigid_only:
        _require_rigid(chain, chosen)

    if held is not None:
        motion = holding(motion, held)
    elif generic_rank is not None and generic_rank < chain.constraint_row_count:
        motion = replace(motion, generic_rank=generic_rank)
    regular, touching = sequential(motion, route), None
    if chain.touching is not None:
        touching = touching_forces(motion, state, regular)
        if touching.closed.any():
            require_resolved(touching.solution, chain.touching.names_of(touching.closed))
            motion = pushed(motion, state, touching.solution.wrench)
            regular = sequential(motion, route)
    for name, pivots in zip(chain.grasps, regular.pivots, strict=True):
        _require_inertia(f"arm '{name}'", pivots)
    _require_inertia("trunk", regular.trunk_pivots)
    _require_finite(regular)
    if held is None and motion.generic_rank is None:
        rank.require_trusted(motion, state, rank.Pivots(int(regular.rank), 1.0 / float(regular.weakest_pivot)))
    status = rank.status_at(chain, state, int(regular.rank), generic_rank)
    try:  # without a grasp there are no constraint forces to solve for
        found = regular if chosen.solve is sequential or not chain.grasps else chosen.solve(motion)
    except MethodNotApplicable as cause:
        raise MethodNotApplicable(f"{chosen.name}: {cause}") from cause
    if status is Status.INDETERMINATE_FORCES and held is None:  # given rows to hold determine the forces
        found = with_smallest_forces(motion, replace(found, rank=regular.rank))
    return _assemble(motion, found, regular, status, chosen.name, touching)


def _require_finite(found: Solution) -> None:
    """Refuse results that overflow, so that no NaN is ever returned."""
    of_trunk = [part for part in found.trunk if part is not None]
    if not np.isfinite(np.concatenate([*found.qdd, *found.wrenches, found.object_acceleration, *of_trunk])).all():
        raise StateError("the accelerations overflow float64; check the sizes of lengths, masses, rates and torques")


def _require_rigid(chain: ClosedChain, method: Method) -> None:
    other = [f"'{name}' is a {grasp.kind} grasp" for name, grasp in chain.grasps.items() if grasp.free]
    if other:
        listed = ", ".join(other[:3]) + (f" and {len(other) - 3} more" if len(other) > 3 else "")
        raise MethodNotApplicable(
            f"{method.name}: for rigid grasps only, but {listed}; try method='sequential' or 'nonrigid'"
        )


def _require_inertia(what: str, pivots: Array) -> None:
    """Refuse an arm or a trunk whose mass matrix is singular because everything beyond a joint is massless."""
    lacking = np.flatnonzero(~(pivots > LEAST_INERTIA * np.max(pivots, initial=0.0, where=np.isfinite(pivots))))
    if lacking.size:
        k = int(lacking[-1])  # the singular pivot nearest the tip makes those closer to the base singular too
        if not np.isfinite(pivots[k]):
            raise ModelError(
                f"{what}, joint {k + 1}: the inertia about its axis overflows float64; check the masses and lengths of"
                " the links beyond it"
            )
        raise ModelError(
            f"{what}, joint {k + 1}: the inertia about its axis is {pivots[k]:.3g}, expected > 0; give the links"
            " beyond it mass or inertia, or the joint an armature, and keep the links' masses within 1e12 of each other"
        )


def _assemble(
    motion: ChainMotion,
    found: Solution,
    regular: Solution,
    status: Status,
    method: str,
    touching: TouchingForces | None,
) -> ForwardResult:
    """Return the result in the order of the chain's arms, including arms without a grasp."""
    chain = motion.chain
    results = chain_solution(motion, found, "auto")._asdict()
    for name, pivots in results.pop("lone_pivots").items():
        _require_inertia(f"arm '{name}'", pivots)
    return ForwardResult(
        chain=chain,
        **results,
        rank=int(regular.rank),
        mobility=chain.velocity_count + chain.contact_freedom_count - int(regular.rank),
        status=status,
        condition=1.0 / float(regular.weakest_pivot),
        method=method,
        held=regular.held,
        **({} if touching is None else touching.of_result(found.object_acceleration + pseudo_gravity(chain))),
    )


def _solution(case: VariedCase) -> tuple[Array, ...]:
    motion = chain_motion(case.chain, case.state, case.own["tau"], case.inputs)
    found = chain_solution(motion, sequential(motion), "auto")
    return tuple(getattr(found, ARRAYS[name].field or name) for name in results_of(case.chain))


FORWARD_DYNAMICS = declare(
    Question(
        "forward_dynamics",
        _solution,
        (*RESULTS, FLOATING_RESULT, BASE_RESULT),
        "joint accelerations, the wrench at every grasp and the object's acceleration",
        inputs=STATE_AND_TORQUES,
        parameters=("object_wrench", "gravity", *OBJECT, "base_R", "base_twist", "base_acceleration", "grasp_R"),
        arguments=(*ARGUMENTS, *TRUNK_LINKS, "trunk_link_wrench", *FLOATING, *TRUNK_BASE_MOTION),
        by=STATE_AND_TORQUES,
        of=("qdd", "grasp_wrench"),
        depends_on=("grasps", "links", "forces", "bushings", "world"),
        returns="CompiledResult",
    )
)
