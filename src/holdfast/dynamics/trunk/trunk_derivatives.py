"""Derivatives of the trunk's equations: gradients come from the bases mounted on the trunk, and rates go to them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion
from holdfast.dynamics.closed.second_solve import Point, TrunkLoad
from holdfast.dynamics.closed.virtual_power import ArmUnknowns
from holdfast.dynamics.trunk.trunk_power import MOTION, MountedBase, TrunkCase, TrunkUnknowns
from holdfast.questions.arrays import BASE_RESULT, FLOATING_RESULT, LINKS, OF_JOINTS, TRUNK_LINKS
from holdfast.spatial.pose import by_motion, by_motions, rates_of
from holdfast.spatial.scalar import Array, concatenate, each_of

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


def trunk_load(motion: ChainMotion, cotangents: Mapping[str, Array]) -> TrunkLoad:
    """Return the trunk's part of the cotangents; that of its base wrench is minus a virtual twist of the base."""
    none, part = np.zeros(6), motion.trunk.joints
    torque = cotangents["qdd"][part] if "qdd" in cotangents else np.zeros(part.stop - part.start)
    wrench, base = (cotangents.get(name, none) for name in (FLOATING_RESULT, BASE_RESULT))
    return TrunkLoad(torque, wrench, none if motion.trunk.floats else -base)


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
    chain, case, part = at.motion.chain, at.motion.trunk_case, at.motion.trunk.joints
    assert case is not None
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
    assert case is not None
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
    assert case is not None
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
