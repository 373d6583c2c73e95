"""Forward dynamics of a closed chain: the front door to every algorithm."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics import indeterminate, rank
from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution, chain_motion
from holdfast.dynamics.closed.chain_solution import chain_solution
from holdfast.dynamics.closed.general import FreeDynamics
from holdfast.dynamics.closed.held_rows import holding
from holdfast.dynamics.closed.sequential import sequential
from holdfast.dynamics.closed.tip_response import NO_INERTIA, Route
from holdfast.dynamics.consistency import require_closed
from holdfast.dynamics.methods import Method, method_named
from holdfast.dynamics.result import ForwardResult, Status
from holdfast.errors import MethodNotApplicable, ModelError, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State


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
    """Return joint accelerations, the force at every grasp and the object's acceleration.

    Solves M qdd + C + J^T f = T, M(C) alpha(C) + b(C) = A^T f with the grasps closed,
    (2.10) for rigid grasps and (b.1) for all. O(n) + O(l) by `sequential`; the others' costs are in `METHODS`.

    Args:
        chain: arms, object and grasps.
        state: positions and velocities; must satisfy the grasps.
        tau: (n,) joint torques, arms in order, base to tip [N m or N].
        inputs: external wrenches and base motion; zero by default.
        method: an algorithm's name (`holdfast methods` lists them), or a free dynamics
            `(ArmMotion, torque, tip_wrench) -> qdd` to be used in (4.9).
        route: for `sequential`: "recursive", "mass_matrix" or "auto".
        check: False skips the consistency check (integrators project instead).
        generic_rank: rank of the constraint away from singular configurations, if known.
        held: which components of the grasps to hold, as a result nearby says it (`ForwardResult.held`);
            for states beside the constraint, whose rank means nothing where rows depend on each other.

    Returns:
        A `ForwardResult`.

    Raises:
        StateError: wrong shapes, or the state breaks a grasp, or is so far beside the constraint that its rank there
            is another.
        SingularChainError: the constraint's rank drops here.
        MethodNotApplicable: the chosen algorithm does not cover this chain.
    """
    checks.instance(chain, ClosedChain, "chain")
    checks.instance(state, State, "state", StateError)
    state.fits(chain)
    tau = checks.numbers(tau, (chain.joint_count,), "tau", StateError)
    given = (inputs or Inputs()).shaped(chain)
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
    with np.errstate(all="ignore"):  # what comes out of it is looked at below
        regular = sequential(motion, route)
    for name, pivots in zip(chain.grasps, regular.pivots, strict=True):
        _require_inertia(f"arm '{name}'", pivots)
    if regular.trunk_pivots is not None:
        _require_inertia("trunk", regular.trunk_pivots)
    _require_finite(regular)
    if held is None and motion.generic_rank is None:
        rank.require_trusted(motion, state, rank.Pivots(int(regular.rank), 1.0 / float(regular.weakest_pivot)))
    status = rank.status_at(chain, state, int(regular.rank), generic_rank)
    try:  # without a grasp there is nothing to solve for: object and arms are alone
        found = regular if chosen.solve is sequential or not chain.grasps else chosen.solve(motion)
    except MethodNotApplicable as cause:
        raise MethodNotApplicable(f"{chosen.name}: {cause}") from cause
    if status is Status.INDETERMINATE_FORCES and held is None:  # beside the constraint no force is free
        found = indeterminate.with_smallest_forces(motion, replace(found, rank=regular.rank))
    return _assemble(motion, found, regular, status, chosen.name)


def _require_finite(found: Solution) -> None:
    """Refuse numbers that overflow: no NaN leaves this library."""
    of_trunk = [] if found.trunk is None else [part for part in found.trunk if part is not None]
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
    """Refuse an arm or a trunk whose mass matrix is singular: a massless link that nothing loads."""
    lacking = np.flatnonzero(~(pivots > NO_INERTIA * np.max(pivots, initial=0.0, where=np.isfinite(pivots))))
    if lacking.size:
        k = int(lacking[-1])  # the one nearest the tip spoils those before it
        raise ModelError(
            f"{what}, joint {k + 1}: the inertia about its axis is {pivots[k]:.3g}, expected > 0; give the links"
            " beyond it mass or inertia, or the joint an armature, and keep the links' masses within 1e12 of each other"
        )


def _assemble(motion: ChainMotion, found: Solution, regular: Solution, status: Status, method: str) -> ForwardResult:
    """Return the result in the chain's layout, arms without a grasp included."""
    chain = motion.chain
    with np.errstate(all="ignore"):
        whole = chain_solution(motion, found, "auto")
    for name, pivots in whole.lone_pivots.items():
        _require_inertia(f"arm '{name}'", pivots)
    return ForwardResult(
        chain=chain,
        qdd=whole.qdd,
        grasp_wrench=whole.grasp_wrench,
        object_acceleration=whole.object_acceleration,
        contact_acceleration=whole.contact_acceleration,
        base_wrench=whole.base_wrench,
        rank=int(regular.rank),
        mobility=chain.velocity_count + chain.contact_freedom_count - int(regular.rank),
        status=status,
        condition=1.0 / float(regular.weakest_pivot),
        method=method,
        held=regular.held,
        base_acceleration=whole.base_acceleration,
        trunk_base_wrench=whole.trunk_base_wrench,
    )
