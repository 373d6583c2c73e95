"""Derivatives of the trunk's equations, and a second solve K z = r of the equations of a chain with a trunk.

Gradients come from the bases mounted on the trunk, and rates go to them. The second solve is that of the chain at rest
with given loads (`closed.second_solve`). In r, the trunk's joints have torques, and a floating base has a wrench. A
base fixed in the world may have an acceleration, and so may the base of every arm relative to the trunk; these are the
cotangents of the wrenches at these bases.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.chain_solution import base_wrench
from holdfast.dynamics.closed.held_rows import holding
from holdfast.dynamics.closed.second_solve import Load, Point, arm_solution, loaded_response, right_hand_side
from holdfast.dynamics.closed.tip_response import TipResponse
from holdfast.dynamics.closed.virtual_power import ArmUnknowns
from holdfast.dynamics.tree.of_chain import chain_elimination
from holdfast.dynamics.trunk.trunk_motion import TrunkMotion
from holdfast.dynamics.trunk.trunk_power import MOTION, MountedBase, TrunkCase, TrunkUnknowns
from holdfast.model.trunk import TRUNK
from holdfast.questions.arrays import BASE_RESULT, FLOATING_RESULT, LINKS, OF_JOINTS, TRUNK_LINKS
from holdfast.spatial.pose import by_motion, by_motions, rates_of
from holdfast.spatial.scalar import Array, concatenate, each, each_of
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench

# Arguments of the trunk only, and their names in its equations.
TRUNK_TO_ARM_NAMES = {
    **dict(zip(TRUNK_LINKS, LINKS, strict=True)),
    "trunk_link_wrench": "wrenches",
    "trunk_base_twist": "base_twist",
    "trunk_base_acceleration": "base_acceleration",
    "floating_twist": "base_twist",
}
# The rates of the trunk's dL/dy for rates of the arguments and of the dL/dy of its arms.
TrunkRates = Callable[[Mapping[str, Array], Mapping[str, ArmUnknowns]], TrunkUnknowns]


def trunk_load(at: Point, cotangents: Mapping[str, Array]) -> TrunkLoad:
    """Return the trunk's part of the cotangents; that of its base wrench is minus a virtual twist of the base."""
    chain, none = at.motion.chain, np.zeros(6)
    part = chain.joints[TRUNK]
    torque = cotangents["qdd"][part] if "qdd" in cotangents else np.zeros(part.stop - part.start)
    wrench, base = (cotangents.get(name, none) for name in (FLOATING_RESULT, BASE_RESULT))
    return TrunkLoad(torque, wrench, none if chain.floats else -base)


def trunk_gradient(
    case: TrunkCase, z: TrunkUnknowns, y: TrunkUnknowns, of_bases: Sequence[MountedBase], by: Sequence[str]
) -> dict[str, Array]:
    """Return the trunk's part of gradients by some arguments; "base_pose" has one row per arm mounted on the trunk."""
    names = [name for name in OF_JOINTS if name in by]
    names += [TRUNK_TO_ARM_NAMES[name] for name in TRUNK_TO_ARM_NAMES if name in by]
    names += ["base_acceleration"] if "gravity" in by else []
    names += ["place_R", "place_p"] if "base_pose" in by else []
    names += ["base_R", "base_p"] if "floating_pose" in by else []
    names = list(dict.fromkeys(names))
    found = case.gradient(z, y, of_bases, names) if names else {}
    numbers = case.numbers(names)
    parts = {name: found[name] for name in OF_JOINTS if name in by}
    parts |= {name: found[own] for name, own in TRUNK_TO_ARM_NAMES.items() if name in by}
    if "gravity" in by:
        parts["gravity"] = -found["base_acceleration"][3:]
    if "floating_pose" in by:
        parts["floating_pose"] = by_motion(found["base_R"], numbers["base_R"], found["base_p"])
    if "base_pose" in by:
        parts["base_pose"] = by_motions(found["place_R"], numbers["place_R"], found["place_p"])
    return parts


def trunk_rates(at: Point, tangents: Mapping[str, Array]) -> dict[str, Array]:
    """Return the rates of the numbers in the trunk's equations for tangents of the chain's arguments."""
    chain, case = at.motion.chain, at.motion.trunk_case
    assert case is not None
    part = chain.joints[TRUNK]
    found = {name: tangents[name][part] for name in OF_JOINTS if name in tangents}
    found |= {own: tangents[name] for name, own in TRUNK_TO_ARM_NAMES.items() if name in tangents}
    if "gravity" in tangents:
        pseudo = concatenate([np.zeros(3), tangents["gravity"]])
        found["base_acceleration"] = found.get("base_acceleration", np.zeros(6)) - pseudo
    found |= rates_of(tangents, "floating", case.base.R, "base")
    if "base_pose" in tangents:
        rows = [chain.names.index(name) for name in case.mounts]
        moved = [
            rates_of({"base_pose": tangents["base_pose"][row]}, "base", place.R)
            for row, (_, place) in zip(rows, case.mounts.values(), strict=True)
        ]
        found["place_R"] = np.array([one["base_R"] for one in moved]).reshape(-1, 3, 3)
        found["place_p"] = np.array([one["base_p"] for one in moved]).reshape(-1, 3)
    return found


def multipliers_through_trunk(
    at: Point, loads: Mapping[str, Load], alpha_bar: Array, load: TrunkLoad
) -> tuple[dict[str, ArmUnknowns], Array, TrunkUnknowns]:
    """Return y by arm including the virtual twists of all bases, y_a, and the trunk's part of y."""
    case = at.motion.trunk_case
    assert case is not None and at.trunk is not None
    solved = second_solve_through_trunk(at, loads, alpha_bar, load)
    carried = case.carried(at.trunk, solved.trunk)
    bases = {name: load.base for name, load in loads.items()}
    bases |= {name: bases[name] + base.virtual for name, base in carried.items()}
    y = {name: one._replace(base=bases[name]) for name, one in solved.arms.items()}
    return y, solved.object_acceleration, solved.trunk


def gradient_through_trunk(
    at: Point,
    z: Mapping[str, ArmUnknowns],
    y: Mapping[str, ArmUnknowns],
    of_trunk: TrunkUnknowns,
    of_arms: Mapping[str, dict[str, Array]],
    by: Sequence[str],
) -> dict[str, Array]:
    """Return the trunk's part of the gradients, including the effect through the bases of its arms.

    In `of_arms`, the rows by the base poses of arms on the trunk are replaced by those relative to the trunk's bodies,
    and rows by arguments that the trunk determines are set to 0.
    """
    case = at.motion.trunk_case
    assert case is not None and at.trunk is not None
    of_bases = []
    for name, wrench in zip(case.mounts, base_wrenches(at, z, y), strict=True):
        g = of_arms[name]
        R, p, twist, acceleration = (g[part] for part in MOTION)
        of_bases.append(MountedBase(R, p, twist, acceleration, -wrench))
        g |= {"base_twist": np.zeros(6), "base_acceleration": np.zeros(6)}
    below = trunk_gradient(case, at.trunk, of_trunk, of_bases, by)
    if "base_pose" in by:
        for name, row in zip(case.mounts, below["base_pose"], strict=True):
            of_arms[name]["base_pose"] = row
    return below


def trunk_residual_rates_along(at: Point, still: Mapping[str, Array]) -> TrunkRates:
    """Return the rates of the trunk's dL/dy, including those of its arms' base wrenches, for constant z.

    Args:
        at: the point.
        still: the arguments that have rates, with rates of zero.
    """
    case = at.motion.trunk_case
    assert case is not None and at.trunk is not None
    none = {name: ArmUnknowns(*(np.zeros(len(part)) for part in at.unknowns[name])) for name in case.mounts}
    linear = case.residual(at.trunk, base_wrenches(at, at.unknowns, none), list(trunk_rates(at, still)))

    def rates(tangents: Mapping[str, Array], of_arms: Mapping[str, ArmUnknowns]) -> TrunkUnknowns:
        changed = [of_arms[name].base for name in case.mounts]
        return TrunkUnknowns(*linear.rates(*changed, *trunk_rates(at, tangents).values()))

    return rates


def base_wrenches(at: Point, z: Mapping[str, ArmUnknowns], y: Mapping[str, ArmUnknowns]) -> list[Array]:
    """Return the wrench of the trunk on each arm mounted on it, (6,) about the arm's base origin, for any z and y."""
    assert at.motion.trunk_case is not None
    found = each_of(at.motion.trunk_case.mounts, lambda case, z, y: case.base_wrench(z, y), at.cases, z, y)
    return list(found.values())


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
    carried = {name: tip for name, tip in alone.items() if name in trunk.mounts}
    of_arms = dict(zip(chain.grasps, loaded, strict=True)) | carried
    free = motion.body.free.at_rest()
    pushed = free._replace(wrench=shift_wrench(-free.centre, wrench))
    found = chain_elimination(chain, at_rest, of_arms, pushed, trunk)
    alpha, betas = found.object_acceleration, {name: found.columns.get(name) for name in chain.arms}
    assert found.trunk is not None
    holds = each(
        lambda c, tip, load, f, own, beta: arm_solution(c, tip, load, f + own, alpha, beta),
        contacts,
        tips,
        held,
        found.wrenches,
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
