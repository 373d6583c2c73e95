"""Forward dynamics of a closed chain: the front door to every algorithm."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from holdfast.dynamics import indeterminate, rank
from holdfast.dynamics.arm.articulated import articulated_filter
from holdfast.dynamics.arm.free_dynamics import tip_acceleration
from holdfast.dynamics.arm.newton_euler import newton_euler
from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution, chain_motion, pseudo_gravity
from holdfast.dynamics.closed.sequential import sequential
from holdfast.dynamics.closed.tip_response import Route, tip_response
from holdfast.dynamics.consistency import require_closed
from holdfast.dynamics.methods import Method, method_named
from holdfast.dynamics.result import ForwardResult, Status
from holdfast.errors import MethodNotApplicable, ModelError, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array, concatenate
from holdfast.spatial.spatial_vector import shift_twist
from holdfast.state import Inputs, State


def forward_dynamics(
    chain: ClosedChain,
    state: State,
    tau: Array,
    *,
    inputs: Inputs | None = None,
    method: str | Callable[..., Array] = "sequential",
    route: Route = "auto",
    check: bool = True,
    generic_rank: int | None = None,
) -> ForwardResult:
    """Return joint accelerations, the force at every grasp and the object's acceleration.

    Solves M qdd + C + J^T f = T, M(C) alpha(C) + b(C) = A^T f with the grasps closed,
    (2.10) for rigid grasps and (b.1) for all.

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

    Returns:
        A `ForwardResult`.

    Raises:
        StateError: wrong shapes, or the state breaks a grasp.
        SingularChainError: the constraint's rank drops here.
        MethodNotApplicable: the chosen algorithm does not cover this chain.
    """
    state.fits(chain)
    tau = checks.numbers(tau, (chain.joint_count,), "tau", StateError)
    given = (inputs or Inputs()).shaped(chain)
    motion = chain_motion(chain, state, tau, given)
    if check:
        require_closed(motion, state)
    chosen = method_named(method)
    if chosen.rigid_only:
        _require_rigid(chain, chosen)

    _require_inertia(motion)
    regular = sequential(motion, route)
    verdict = rank.verdict(chain, state, int(regular.rank), generic_rank)
    try:
        found = regular if chosen.solve is sequential else chosen.solve(motion)
    except MethodNotApplicable as cause:
        raise MethodNotApplicable(f"{chosen.name}: {cause}") from cause
    if verdict is Status.INDETERMINATE_FORCES:
        found = indeterminate.with_smallest_forces(motion, found)
    return _assemble(motion, found, regular, verdict, chosen.name)


def _require_rigid(chain: ClosedChain, method: Method) -> None:
    other = {name: grasp.kind for name, grasp in chain.grasps.items() if grasp.kind != "rigid"}
    if other:
        listed = ", ".join(f"'{name}' is a {kind}" for name, kind in other.items())
        raise MethodNotApplicable(
            f"{method.name}: for rigid grasps only, but {listed}; try method='sequential' or 'nonrigid'"
        )


def _require_inertia(motion: ChainMotion) -> None:
    """Refuse an arm whose mass matrix is singular: a massless link that nothing loads."""
    for name, arm in motion.arms.items():
        if not arm.arm.may_lack_inertia:
            continue
        with np.errstate(all="ignore"):
            D = articulated_filter(arm.arm, arm.at).D
        lacking = np.flatnonzero(~(D > 0))
        if lacking.size:
            k = int(lacking[-1])  # the one nearest the tip spoils those before it
            raise ModelError(
                f"arm '{name}', joint {k + 1}: the inertia about its axis is {D[k]:.3g}, expected > 0; give the links"
                " beyond it mass or inertia, or the joint an armature"
            )


def _assemble(motion: ChainMotion, found: Solution, regular: Solution, status: Status, method: str) -> ForwardResult:
    """Return the result in the chain's layout, arms without a grasp included."""
    chain = motion.chain
    qdd = np.zeros(chain.joint_count)
    wrenches = np.zeros((len(chain.arms), 6))
    base = np.zeros((len(chain.arms), 6))
    holding = {name: i for i, name in enumerate(chain.grasps)}
    for row, (name, arm) in enumerate(motion.arms.items()):
        part = chain.joints[name]
        if name in holding:
            qdd[part], wrenches[row] = found.qdd[holding[name]], found.wrenches[holding[name]]
            base[row] = newton_euler(arm, qdd[part], wrenches[row])[1]
        else:
            qdd[part], base[row] = tip_response(arm, "auto").back(np.zeros(6))

    W_dot = found.contact_acceleration
    if W_dot is None:
        W_dot = contact_acceleration(motion, found)
    return ForwardResult(
        chain=chain,
        qdd=qdd,
        grasp_wrench=wrenches,
        object_acceleration=found.object_acceleration + pseudo_gravity(chain),
        contact_acceleration=W_dot,
        base_wrench=base,
        rank=int(regular.rank),
        mobility=chain.joint_count + 6 + chain.contact_freedom_count - int(regular.rank),
        status=status,
        condition=1.0 / float(regular.weakest_pivot),
        method=method,
    )


def contact_acceleration(motion: ChainMotion, found: Solution) -> Array:
    """Return W_dot = h^T (A alpha(C) + a(C) - alpha+ - g), flat (a.8)."""
    parts = []
    for c, arm, qdd in zip(motion.contacts, motion.holding, found.qdd, strict=True):
        gap = shift_twist(c.offset, found.object_acceleration) + c.a - tip_acceleration(arm, qdd) - c.g
        parts.append(gap[:3] @ c.h)
    return concatenate(parts)
