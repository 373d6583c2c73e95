"""The solution of an algorithm in the layout of the chain, including the arms without a grasp."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.free_dynamics import tip_acceleration
from holdfast.dynamics.arm.motion import ArmMotion
from holdfast.dynamics.arm.newton_euler import newton_euler
from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution, pseudo_gravity
from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.closed.tip_response import Route, responded, tip_response
from holdfast.dynamics.trunk.trunk_motion import TrunkMotion
from holdfast.spatial.scalar import Array, array, concatenate, each, each_of
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench


class ChainSolution(NamedTuple):
    """The solution of closed-chain forward dynamics for the whole chain, in world axes.

    Attributes:
        qdd: (n,) joint accelerations.
        grasp_wrench: (arms, 6) wrench of each arm on the object, about the contact point; 0 without a grasp.
        object_acceleration: (6,) acceleration of C.
        contact_acceleration: W_dot of all grasps, flat.
        base_wrench: (arms, 6) wrench of the base on each arm, about the base origin.
        lone_pivots: articulated inertias of the arms without a grasp, by name.
        base_acceleration: (6,) true acceleration of a floating base; None without one.
        trunk_base_wrench: (6,) wrench of the base on the trunk, about the base origin; None without a trunk.
    """

    qdd: Array
    grasp_wrench: Array
    object_acceleration: Array
    contact_acceleration: Array
    base_wrench: Array
    lone_pivots: dict[str, Array]
    base_acceleration: Array | None = None
    trunk_base_wrench: Array | None = None


def chain_solution(motion: ChainMotion, found: Solution, route: Route) -> ChainSolution:
    """Return accelerations and forces of all arms. O(n) + O(l).

    Args:
        motion: the chain's motion.
        found: solution of an algorithm for the arms with a grasp.
        route: method for the arms without a grasp, see `tip_response`.
    """
    chain = motion.chain
    lone = [name for name in chain.arms if name not in chain.grasps]
    trunk, betas = motion.trunk, motion.trunk.accelerations(found.trunk)
    of_columns = {name: trunk.of_columns(name, found.trunk, betas) for name in lone}
    holds = [trunk.under(name, betas) for name in chain.grasps]
    alone = each_of(lone, lambda arm, beta: unloaded(arm, route, beta), motion.arms, of_columns)
    bases = found.base_wrenches
    if bases is None:
        bases = each(
            lambda arm, qdd, f, beta: newton_euler(arm, qdd, f, beta)[1],
            motion.holding,
            found.qdd,
            found.wrenches,
            holds,
        )
    rates = found.contact_acceleration
    if rates is None:
        alpha = found.object_acceleration
        parts = each(
            lambda arm, c, qdd, beta: contact_acceleration(arm, c, qdd, alpha, beta),
            motion.holding,
            motion.contacts,
            found.qdd,
            holds,
        )
        rates = concatenate(parts)
    whole = [f if arm.known is None else f + arm.known for arm, f in zip(motion.holding, found.wrenches, strict=True)]
    holding = zip(chain.grasps, zip(found.qdd, whole, bases, strict=True), strict=True)
    none = np.zeros(6)
    of_arm = dict(holding) | {name: (qdd, none, base) for name, (qdd, base, _) in alone.items()}
    return ChainSolution(
        concatenate([found.trunk.qdd, *(of_arm[name][0] for name in chain.arms)]),
        array([of_arm[name][1] for name in chain.arms]).reshape(-1, 6),
        found.object_acceleration + pseudo_gravity(chain),
        rates,
        array([of_arm[name][2] for name in chain.arms]).reshape(-1, 6),
        {name: pivots for name, (_, _, pivots) in alone.items()},
        found.trunk.base,
        base_wrench(trunk, betas, {name: of_arm[name][2] for name in trunk.mounts}),
    )


def base_wrench(trunk: TrunkMotion, betas: Sequence[Array], of_arms: Mapping[str, Array]) -> Array | None:
    """Return the wrench of the base on the trunk, (6,) about the base origin, world axes; 0 for a floating base.

    Without bodies there is none.

    Args:
        trunk: the trunk's motion.
        betas: per body, the acceleration that is added by the accelerations of the trunk's joints.
        of_arms: by name, the wrench of the trunk on each arm, about the arm's base origin.
    """
    if trunk.floats or not trunk.bodies:
        return np.zeros(6) if trunk.floats else None
    *_, (_, _, total) = trunk.loads(betas, of_arms)
    return shift_wrench(trunk.bodies[0].reach, total)


def unloaded(arm: ArmMotion, route: Route, beta: Array | None = None) -> tuple[Array, Array, Array]:
    """Return qdd, the base's wrench on the arm, and the pivots of an arm without a grasp."""
    tip = tip_response(arm, route)
    return *responded(tip, np.zeros(6), beta), tip.pivots


def contact_acceleration(arm: ArmMotion, c: Contact, qdd: Array, alpha: Array, beta: Array | None = None) -> Array:
    """Return W_dot = h^T (A alpha(C) + a(C) - alpha+ - g) of one grasp (a.8)."""
    return c.rates(shift_twist(c.offset, alpha) + c.a - tip_acceleration(arm, qdd, beta) - c.g)
