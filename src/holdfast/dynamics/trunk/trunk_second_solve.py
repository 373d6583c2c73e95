"""A second solve of the equations of a chain with a trunk, K z = r, which is the chain at rest with given loads.

See `closed.second_solve`. In r, the trunk's joints have torques, and a floating base has a wrench. A base fixed in the
world may have an acceleration, and so may the base of every arm relative to the trunk; these are the cotangents of the
wrenches at these bases.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.chain_solution import base_wrench
from holdfast.dynamics.closed.held_rows import holding
from holdfast.dynamics.closed.second_solve import Load, Point, arm_solution, loaded_response, right_hand_side
from holdfast.dynamics.closed.tip_response import TipResponse
from holdfast.dynamics.closed.virtual_power import ArmUnknowns
from holdfast.dynamics.trunk.trunk_filter import trunk_filter
from holdfast.dynamics.trunk.trunk_motion import TrunkMotion
from holdfast.dynamics.trunk.trunk_power import TrunkUnknowns
from holdfast.spatial.scalar import Array, each, each_of
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench


class TrunkLoad(NamedTuple):
    """The trunk's part of r.

    Attributes:
        torque: (n_t,) torques of its joints.
        wrench: (6,) wrench on a floating base about its origin, world axes; 0 without one.
        base: (6,) acceleration of a base in the world; 0 for a floating base.
    """

    torque: Array
    wrench: Array
    base: Array


class SecondSolution(NamedTuple):
    """The solution z of a chain with a trunk.

    Attributes:
        arms: parts of z by arm; `base` is the wrench of the base, or of the trunk, on the arm.
        object_acceleration: (6,) acceleration of the object.
        trunk: accelerations of the trunk's joints and base.
        base_wrench: (6,) wrench of the base on the trunk.
    """

    arms: dict[str, ArmUnknowns]
    object_acceleration: Array
    trunk: TrunkUnknowns
    base_wrench: Array


def second_solve_through_trunk(at: Point, loads: Mapping[str, Load], wrench: Array, load: TrunkLoad) -> SecondSolution:
    """Return z. O(n) + O(l).

    Args:
        at: the point.
        loads: loads by arm; for arms without a grasp the gap is not used.
        wrench: (6,) wrench on the object about C, world axes.
        load: load of the trunk.
    """
    motion = at.motion if at.found.held is None else holding(at.motion, at.found.held)
    chain, contacts, none = motion.chain, motion.contacts, np.zeros(6)
    assert motion.trunk is not None
    trunk = driven_trunk(motion.trunk, load)
    loads = {
        name: one._replace(base=one.base + trunk.mounts[name].acceleration) if name in trunk.mounts else one
        for name, one in loads.items()
    }
    lone = [name for name in chain.arms if name not in chain.grasps]
    held = [loads[name] for name in chain.grasps]
    tips, known, gaps, wrench = right_hand_side(motion, [at.tips[name] for name in chain.grasps], loads, wrench)
    alone = each_of(lone, loaded_response, at.tips, motion.arms, loads)
    loaded = each(reading, tips, known, gaps)
    at_rest = [replace(c, a=none, g=none) for c in contacts]
    grasps = dict(zip(chain.grasps, zip(at_rest, loaded, strict=True), strict=True))
    carried = {name: tip for name, tip in alone.items() if name in trunk.mounts}
    free = motion.body.free.at_rest()
    found = trunk_filter(trunk, grasps, carried, free._replace(wrench=shift_wrench(-free.centre, wrench)))
    alpha = found.found.object_acceleration
    assert found.trunk is not None
    betas = {name: found.of_columns(trunk, name) for name in chain.arms}
    holds = each(
        lambda c, tip, load, f, own, beta: arm_solution(c, tip, load, f + own, alpha, beta),
        contacts,
        tips,
        held,
        found.found.wrenches,
        known,
        [betas[name] for name in chain.grasps],
    )
    others = each_of(lone, lambda tip, beta: tip.back_substitute(none, beta), alone, betas)
    solved = {name: ArmUnknowns(qdd, none, none[:0], alpha, base) for name, (qdd, base) in others.items()}
    solved |= dict(zip(chain.grasps, holds, strict=True))
    of_base = base_wrench(trunk, found.betas, {name: solved[name].base for name in trunk.mounts})
    moved = load.base if found.trunk.base is None else found.trunk.base
    return SecondSolution(solved, alpha, TrunkUnknowns(found.trunk.qdd, moved), of_base)


def driven_trunk(trunk: TrunkMotion, load: TrunkLoad) -> TrunkMotion:
    """Return the trunk at rest with a load."""
    still, zeta, bodies, k = trunk.at_rest(), load.base, [], 0
    for body in still.bodies:
        if body.joint is None:
            bodies.append(body._replace(wrench=-load.wrench))
            continue
        zeta = shift_twist(body.reach, zeta)
        bodies.append(body._replace(zeta=zeta, wrench=body.inertia.apply(zeta), torque=load.torque[k]))
        k += 1
    mounts = {
        name: mount._replace(acceleration=shift_twist(mount.offset, bodies[mount.body].zeta))
        for name, mount in still.mounts.items()
    }
    return still._replace(bodies=bodies, mounts=mounts)


def reading(tip: TipResponse, known: Array, gap: Array) -> TipResponse:
    """Return the tip response for the filter: r at the tip, and at the base the load X^T f of a known wrench f."""
    base = tip.base
    if base is not None:
        base = base._replace(wrench=base.wrench + known @ base.X)
    return replace(tip, free_acceleration=gap, base=base)
