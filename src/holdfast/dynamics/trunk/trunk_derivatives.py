"""Gradients and rates of a chain's trunk: from the bases that it carries, and to them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from holdfast.dynamics.closed.pose_tangents import by_motion, by_motions, rates_of
from holdfast.dynamics.closed.second_solve import Point
from holdfast.dynamics.trunk.trunk_power import CarriedBase, TrunkCase, TrunkUnknowns
from holdfast.dynamics.trunk.trunk_second_solve import TrunkLoad
from holdfast.model.closed_chain import TRUNK
from holdfast.spatial.scalar import Array, concatenate

OF_JOINTS = ("q", "qd", "tau", "armature", "damping")
# Arguments that are the trunk's alone, and what they are called in its equations.
OF_TRUNK = {
    "trunk_link_wrench": "wrenches",
    "trunk_base_twist": "base_twist",
    "trunk_base_acceleration": "base_acceleration",
    "floating_twist": "base_twist",
}
OF_FLOATING = ("floating_pose", "floating_twist")
OF_STANDING = ("trunk_base_twist", "trunk_base_acceleration")
FLOATING_RESULT, BASE_RESULT = "floating_acceleration", "trunk_base_wrench"


def trunk_load(at: Point, cotangents: Mapping[str, Array]) -> TrunkLoad:
    """Return the trunk's part of cotangents. One of its base's wrench is a virtual twist of the base, negative."""
    chain, none = at.motion.chain, np.zeros(6)
    part = chain.joints[TRUNK]
    torque = cotangents["qdd"][part] if "qdd" in cotangents else np.zeros(part.stop - part.start)
    wrench, base = (cotangents.get(name, none) for name in (FLOATING_RESULT, BASE_RESULT))
    return TrunkLoad(torque, wrench, none if chain.floats else -base)


def trunk_gradient(
    case: TrunkCase, z: TrunkUnknowns, y: TrunkUnknowns, of_bases: Sequence[CarriedBase], by: Sequence[str]
) -> dict[str, Array]:
    """Return the trunk's part of gradients by some arguments; of "base_pose" one row an arm that stands on it."""
    names = [name for name in OF_JOINTS if name in by]
    names += [OF_TRUNK[name] for name in OF_TRUNK if name in by]
    names += ["base_acceleration"] if "gravity" in by else []
    names += ["place_R", "place_p"] if "base_pose" in by else []
    names += ["base_R", "base_p"] if "floating_pose" in by else []
    names = list(dict.fromkeys(names))
    found = case.gradient(z, y, of_bases, names) if names else {}
    numbers = case.numbers(names)
    parts = {name: found[name] for name in OF_JOINTS if name in by}
    parts |= {name: found[own] for name, own in OF_TRUNK.items() if name in by}
    if "gravity" in by:
        parts["gravity"] = -found["base_acceleration"][3:]
    if "floating_pose" in by:
        parts["floating_pose"] = by_motion(found["base_R"], numbers["base_R"], found["base_p"])
    if "base_pose" in by:
        parts["base_pose"] = by_motions(found["place_R"], numbers["place_R"], found["place_p"])
    return parts


def trunk_rates(at: Point, tangents: Mapping[str, Array]) -> dict[str, Array]:
    """Return how fast the numbers of the trunk's equations change under tangents of the chain's arguments."""
    chain, case = at.motion.chain, at.motion.trunk_case
    assert case is not None
    part = chain.joints[TRUNK]
    found = {name: tangents[name][part] for name in OF_JOINTS if name in tangents}
    found |= {own: tangents[name] for name, own in OF_TRUNK.items() if name in tangents}
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
