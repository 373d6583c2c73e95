"""Visuals of arms and trunks made of simple solids on the base and on each link."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.held_object import HeldObject
from holdfast.model.joint import Joint
from holdfast.model.link import Link
from holdfast.robots.built_in import builtin_of
from holdfast.robots.primitive import Primitive, box, capsule, cylinder, sphere
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array

THICKNESS = 0.035  # radius of a rod at the base, relative to the arm's length
TAPER = 0.6  # radius of the last rod, relative to the first
DRUM = 1.25  # radius of a drum, relative to its rod
SHORTEST = 1e-3  # shorter arms are drawn as if they were 1 m long [m]
SMALLEST_EDGE = 1e-3  # least edge length of a body's equivalent box [m]


def visuals_of(arm: Arm) -> list[list[Primitive]]:
    """Return the solids of an arm in N + 1 lists, first for the base, then for the links from base to tip.

    An arm with the joints of a built-in robot has the visuals of that robot. Any other arm is drawn from its
    kinematics, with rods from joint to joint, drums along revolute axes and bars along prismatic ones. An anchor is
    drawn as a rod from its base to its tip, if these differ. Poses are in base or link axes. The branches of an arm are
    rods to their frames and to the ends of loops.
    """
    robot = builtin_of(arm)
    if robot is None:
        return _of_kinematics(arm)
    branches = _of_kinematics(arm)[len(robot.visuals) :] if arm.parents else []
    return [*(list(solids) for solids in robot.visuals), *branches]


def arm_length(arm: Arm) -> float:
    """Return the length of the line through all joints to the tip, at q = 0 [m]; 1 m if it is zero.

    That of an arm with branches is the length of the longest one.
    """
    ends = ends_of(arm)
    if not arm.parents:
        return _length(ends)
    so_far: list[float] = []
    for joint, parent in zip(arm.joints, arm.parent_of, strict=True):
        so_far.append((0.0 if parent is None else so_far[parent]) + float(np.linalg.norm(joint.placement.p)))
    beyond = [max((float(np.linalg.norm(end)) for end in own), default=0.0) for own in ends[1:]]
    length = max(a + b for a, b in zip(so_far, beyond, strict=True))
    return length if length > SHORTEST else 1.0


def chain_length(chain: ClosedChain) -> float:
    """Return the length of the longest arm [m], or without joints the longest edge of the objects' equivalent boxes."""
    lengths = [arm_length(arm) for arm in chain.arms.values() if arm.joints]
    edges = [edge for one in chain.free_objects.values() for edge in equal_box(one, "grey").size]
    return max(lengths or edges)


def visuals_of_trunk(chain: ClosedChain) -> list[list[Primitive]]:
    """Return the solids of a chain's trunk, first for its base, then for its links; empty without a trunk.

    A trunk is drawn like an arm, with a rod on each link to every arm mounted there; a floating body is a box with its
    mass and inertia. Poses are in base or link axes.
    """
    trunk = chain.trunk
    if trunk is None:
        return []
    carried: list[list[Arm]] = [[] for _ in range(trunk.joint_count + 1)]  # on its base and on its links
    for name, k in chain.mounted_on.items():
        carried[k if chain.floats else k + 1].append(chain.arms[name])
    starts = [[joint.placement.p] for joint in trunk.joints]
    length = _length([*starts, [arm.base.p for arms in carried for arm in arms]])
    robot = None if trunk.serial is None else builtin_of(trunk.serial)
    bodies = _of_ends([*starts, []], trunk.joints, length) if robot is None else [list(one) for one in robot.visuals]
    for body, arms in zip(bodies, carried, strict=True):
        body += [rod for arm in arms for rod in _link(arm.base.p, THICKNESS * TAPER * min(length, 2 * arm_length(arm)))]
    if trunk.floating is not None and trunk.floating.mass > 0:
        bodies[0].append(equal_box(trunk.floating, "grey"))
    return bodies


def equal_box(body: Link | HeldObject, colour: str) -> Primitive:
    """Return the solid box of uniform density with a body's mass and inertia."""
    edges, at = equivalent_box(body)
    return Primitive("box", at, edges.tolist(), colour)


def equivalent_box(body: HeldObject | Link) -> tuple[Array, Pose]:
    """Return edges (3,) [m] and pose, in the body's axes, of the uniform box with the same inertia.

    x^2 = 6 (Jyy + Jzz - Jxx) / m along principal axes, about the mass centre.
    """
    J = body.inertia
    if np.count_nonzero(J - np.diag(np.diag(J))) == 0:  # keep the axes' order
        moments, axes = np.diag(J), np.eye(3)
    else:
        moments, axes = np.linalg.eigh(J)
        axes = axes * np.linalg.det(axes)
    squares = 6.0 * (moments.sum() - 2.0 * moments) / body.mass
    return np.sqrt(np.maximum(squares, SMALLEST_EDGE**2)), Pose(axes, body.com)


def _of_kinematics(arm: Arm) -> list[list[Primitive]]:
    if not arm.joints:
        return [_link(arm.tip.p, THICKNESS * TAPER * arm_length(arm))]
    slender = {k + 1 for k in range(arm.joint_count) if arm.parents and k not in arm.parents}
    bodies = _of_ends(ends_of(arm), arm.joints, arm_length(arm), slender)
    if not arm.parents:
        bodies[-1].append(sphere(arm.tip.p, 0.8 * TAPER * THICKNESS * arm_length(arm), "dark"))
    return bodies


def _of_ends(
    ends: Sequence[Sequence[Array]], joints: Sequence[Joint], length: float, slender: Collection[int] = ()
) -> list[list[Primitive]]:
    """Return the solids of base and links: rods to all ends, and drums at the joints.

    Args:
        ends: ends of the base and of each link in its axes, (3,) each [m].
        joints: joints of the links.
        length: total length, to which the thickness is proportional [m].
        slender: bodies that are at least four times as long as thick, such as fingers.
    """
    radii = THICKNESS * length * np.linspace(1.0, TAPER, len(ends))
    for k in slender:
        own = 0.25 * max((float(np.linalg.norm(end)) for end in ends[k]), default=0.0)
        radii[k] = min(radii[k], own) if own > 0 else radii[k]
    bodies = [
        [rod for end in here for rod in _link(end, float(radius))] for here, radius in zip(ends, radii, strict=True)
    ]
    for body, joint, radius in zip(bodies[1:], joints, radii, strict=False):
        if joint.type.quaternion:
            body.append(sphere(np.zeros(3), 1.2 * DRUM * float(radius), "accent"))
            continue
        length, width = (1.1, DRUM) if joint.turns else (3.0, 0.5)
        half = length * (DRUM * float(radius) * joint.axis)
        body.append(cylinder(-half, half, width * float(radius), "accent"))
    bodies[0].append(box((0.0, 0.0, 0.0), (3 * radii[0], 3 * radii[0], 0.5 * radii[0]), "dark"))
    return bodies


def _length(ends: Sequence[Sequence[Array]]) -> float:
    """Return the length of the line through the farthest end of each body; 1 m if it is zero."""
    length = float(sum(max((np.linalg.norm(end) for end in here), default=0.0) for here in ends))
    return length if length > SHORTEST else 1.0


def ends_of(arm: Arm) -> list[list[Array]]:
    """Return the positions of the next joints, or of the tip, in the axes of the base and of each link.

    A link without next joints in an arm with branches ends at its frames, and without frames at its mass centre. The
    ends of loops count, too.
    """
    if not arm.parents:
        return [[joint.placement.p] for joint in arm.joints] + [[arm.tip.p]]
    ends: list[list[Array]] = [[] for _ in range(arm.joint_count + 1)]
    for joint, parent in zip(arm.joints, arm.parent_of, strict=True):
        ends[0 if parent is None else parent + 1].append(joint.placement.p)
    leaves = [k for k in range(arm.joint_count) if k not in arm.parent_of]
    for link, pose in arm.frames.values():
        if link in leaves:
            ends[link + 1].append(pose.p)
    for k in leaves:
        if not ends[k + 1]:
            ends[k + 1].append(arm.links[k].com)
    for name, loop in arm.loops.items():
        for end, at in ((loop.a, loop.tip), (loop.b, loop.grasp.frame)):
            link, frame = (-1, Pose.identity()) if end is None else arm.frame(end, f"loop '{name}'")
            ends[link + 1].append((frame @ at).p)
    return ends


def _link(end: Array, radius: float) -> list[Primitive]:
    """Return the rod from the origin to `end`, if it is long enough."""
    return [capsule(np.zeros(3), end, radius)] if np.linalg.norm(end) > 0.2 * radius else []
