"""What an algorithm finds, in the chain's layout: arms that hold nothing included."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.free_dynamics import tip_acceleration
from holdfast.dynamics.arm.motion import ArmMotion
from holdfast.dynamics.arm.newton_euler import newton_euler
from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution, pseudo_gravity
from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.closed.tip_response import Route, responded, tip_response
from holdfast.spatial.scalar import Array, array, concatenate, each
from holdfast.spatial.spatial_vector import shift_twist


class ChainSolution(NamedTuple):
    """The answer of closed-chain forward dynamics, world axes.

    Attributes:
        qdd: (n,) joint accelerations.
        grasp_wrench: (arms, 6) of the arm on the object, about the contact point; 0 without a grasp.
        object_acceleration: (6,) of C.
        contact_acceleration: W_dot, flat.
        base_wrench: (arms, 6) of the base on the arm, about the base origin.
        lone_pivots: by name, articulated inertias of the arms that hold nothing.
    """

    qdd: Array
    grasp_wrench: Array
    object_acceleration: Array
    contact_acceleration: Array
    base_wrench: Array
    lone_pivots: dict[str, Array]


def chain_solution(motion: ChainMotion, found: Solution, route: Route) -> ChainSolution:
    """Return accelerations and forces of all arms. O(n) + O(l).

    Args:
        motion: the chain in motion.
        found: what an algorithm found for the arms that hold.
        route: how arms that hold nothing answer.
    """
    chain = motion.chain
    lone = [name for name in chain.arms if name not in chain.grasps]
    alone = each(lambda arm: unloaded(arm, route), [motion.arms[name] for name in lone])
    bases = found.base_wrenches
    if bases is None:
        bases = each(lambda arm, qdd, f: newton_euler(arm, qdd, f)[1], motion.holding, found.qdd, found.wrenches)
    rates = found.contact_acceleration
    if rates is None:
        alpha = found.object_acceleration
        parts = each(
            lambda arm, c, qdd: contact_acceleration(arm, c, qdd, alpha), motion.holding, motion.contacts, found.qdd
        )
        rates = concatenate(parts)
    holding = zip(chain.grasps, zip(found.qdd, found.wrenches, bases, strict=True), strict=True)
    none = np.zeros(6)
    of_arm = dict(holding) | {name: (qdd, none, base) for name, (qdd, base, _) in zip(lone, alone, strict=True)}
    return ChainSolution(
        concatenate(of_arm[name][0] for name in chain.arms),
        array([of_arm[name][1] for name in chain.arms]),
        found.object_acceleration + pseudo_gravity(chain),
        rates,
        array([of_arm[name][2] for name in chain.arms]),
        {name: pivots for name, (_, _, pivots) in zip(lone, alone, strict=True)},
    )


def unloaded(arm: ArmMotion, route: Route) -> tuple[Array, Array, Array]:
    """Return qdd, the base's wrench on the arm and its pivots, of an arm that holds nothing."""
    tip = tip_response(arm, route)
    return *responded(tip, np.zeros(6)), tip.pivots


def contact_acceleration(arm: ArmMotion, c: Contact, qdd: Array, alpha: Array) -> Array:
    """Return W_dot = h^T (A alpha(C) + a(C) - alpha+ - g) of one grasp (a.8)."""
    gap = shift_twist(c.offset, alpha) + c.a - tip_acceleration(arm, qdd) - c.g
    return gap[:3] @ c.h
