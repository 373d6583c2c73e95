"""One arm in a projection as a stage: its gap at the grasp outward, and back the change that closes it.

The texts are those of `dynamics/projection`: an arm at rest, its gap in the place of the free acceleration.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from holdfast.compiled.arm_stages import CENTRE, LINKS, ArmType, Phases, outward_names, outward_of
from holdfast.compiler.program import Shape
from holdfast.compiler.stage import Stage, stage
from holdfast.dynamics.arm.motion import resting
from holdfast.dynamics.arm.posture import posture
from holdfast.dynamics.arm.velocity import link_twists, tip_twist
from holdfast.dynamics.closed.contact import contact
from holdfast.dynamics.closed.measurement import measurement
from holdfast.dynamics.closed.tip_response import Route, tip_response
from holdfast.dynamics.projection import position_contact, small_displacement
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, maximum
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench

Level = Literal["position", "velocity"]

# Inputs of an arm by level, the object's mobility apart.
_SEEN: dict[Level, tuple[str, ...]] = {
    "position": ("q", "object_R", "object_p"),
    "velocity": ("q", "qd", "object_R", "object_twist"),
}


def tied_arm(of: ArmType, level: Level, route: Route) -> Stage:
    """Return the stage of an arm that holds: what its gap measures, and its change of q or of qd."""
    moving = ("base_twist",) if of.options.base_motion and level == "velocity" else ()
    parameters = of.ports(("base_R", "base_p", *moving, *LINKS, "grasp_R", "grasp_p"))
    inputs = of.ports(_SEEN[level])
    still = np.zeros(6)

    def text(*arrays: Array) -> Phases:
        given = dict(zip(parameters, arrays, strict=True))
        *seen, centre, centripetal = yield ()
        now = dict(zip(inputs, seen, strict=True))
        arm, frame = of.mounted(given), Pose.unchecked(now["object_R"], np.zeros(3))
        at = posture(arm, now["q"])
        c = contact(of.held(given), frame, still, still)
        if level == "position":
            gap = small_displacement(c, now["object_p"] + c.offset, at.tip)
            c = position_contact(c)
        else:
            V = tip_twist(arm, at, link_twists(arm, at, now["qd"], given.get("base_twist", still)))
            gap = V - shift_twist(c.offset, now["object_twist"])
        tip = tip_response(resting(arm, at), route)._replace(free_acceleration=gap)
        about = c.about(centre, centripetal)
        (from_arm,) = yield outward_of(measurement(about, tip))
        f = c.transmissible(shift_wrench(-about.offset, from_arm))
        return (tip.back(f)[0],)

    within: list[dict[str, Shape]] = [parameters, inputs | CENTRE, {"from_arm": (6,)}]
    return stage(f"tied_{level}_{of.kind}", text, within, [(), outward_names(of), ("change",)])


def arm_gaps(of: ArmType) -> Stage:
    """Return the stage of an arm's largest gaps at its grasp, in position and in velocity."""
    moving = ("base_twist",) if of.options.base_motion else ()
    parameters = of.ports(("base_R", "base_p", *moving, "grasp_R", "grasp_p"))
    inputs = of.ports(("q", "qd", "object_R", "object_p", "object_twist"))

    def text(*arrays: Array) -> Phases:
        given = dict(zip(parameters, arrays, strict=True))
        seen = yield ()
        now = dict(zip(inputs, seen, strict=True))
        arm = of.mounted(given)
        at = posture(arm, now["q"])
        V = tip_twist(arm, at, link_twists(arm, at, now["qd"], given.get("base_twist", np.zeros(6))))
        c = contact(of.held(given), Pose.unchecked(now["object_R"], np.zeros(3)), now["object_twist"], V)
        shift = small_displacement(c, now["object_p"] + c.offset, at.tip)
        return _largest(position_contact(c).transmitted(shift)), _largest(c.velocity_gap)

    return stage(f"gaps_{of.kind}", text, [parameters, inputs], [(), ("position", "velocity")])


def untied_arm(of: ArmType) -> Stage:
    """Return the stage of an arm that holds nothing: it is not changed."""

    def text() -> Phases:
        yield ()
        return (np.zeros(of.arm.joint_count),)

    return stage("untied", text, [{}, {}], [(), ("change",)])


def _largest(x: Array) -> Scalar:
    largest: Scalar = 0.0
    for entry in x:
        largest = maximum(largest, abs(entry))
    return largest
