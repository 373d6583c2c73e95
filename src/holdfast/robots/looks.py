"""What an arm looks like: simple solids on its base and on each link."""

from __future__ import annotations

import numpy as np

from holdfast.model.arm import Arm
from holdfast.robots.primitive import Primitive, box, capsule, cylinder, sphere
from holdfast.robots.recognise import builtin_of
from holdfast.spatial.scalar import Array

THICKNESS = 0.035  # of a rod at the base: radius over the arm's length
TAPER = 0.6  # of the last rod's radius over the first's
DRUM = 1.25  # a drum's radius over its rod's


def looks_of(arm: Arm) -> list[list[Primitive]]:
    """Return the solids that show an arm: N + 1 lists, the base's first, then the links' base to tip.

    An arm with the joints of a built-in robot looks like it, whatever it is called and
    whatever it carries; any other is drawn from its kinematics: rods from joint to joint,
    drums along revolute axes, bars along prismatic ones. Poses are in base or link axes.
    """
    robot = builtin_of(arm)
    return _of_kinematics(arm) if robot is None else [list(solids) for solids in robot.looks]


def arm_length(arm: Arm) -> float:
    """Return the length of the line through all joints to the tip, at q = 0 [m]; 1 m if that is nothing."""
    length = float(sum(np.linalg.norm(end) for end in _ends(arm)))
    return length if length > 1e-3 else 1.0


def _of_kinematics(arm: Arm) -> list[list[Primitive]]:
    ends = _ends(arm)
    radii = THICKNESS * arm_length(arm) * np.linspace(1.0, TAPER, len(ends))
    bodies = [_link(end, float(radius)) for end, radius in zip(ends, radii, strict=True)]
    for body, joint, radius in zip(bodies[1:], arm.joints, radii, strict=False):
        length, width = (1.1, DRUM) if joint.turns else (3.0, 0.5)
        half = length * (DRUM * float(radius) * joint.axis)
        body.append(cylinder(-half, half, width * float(radius), "accent"))
    bodies[0].append(box((0.0, 0.0, 0.0), (3 * radii[0], 3 * radii[0], 0.5 * radii[0]), "dark"))
    bodies[-1].append(sphere(arm.tip.p, 0.8 * float(radii[-1]), "dark"))
    return bodies


def _ends(arm: Arm) -> list[Array]:
    """Return per base and link where the next joint, or the tip, lies in its axes."""
    return [*(joint.placement.p for joint in arm.joints), arm.tip.p]


def _link(end: Array, radius: float) -> list[Primitive]:
    """Return the rod from the origin to `end`, if there is room for one."""
    return [capsule(np.zeros(3), end, radius)] if np.linalg.norm(end) > 0.2 * radius else []
