"""The joints of SDF files, as joints of a tree or as loops that they close."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import holdfast.robots.urdf.attributes as attributes
from holdfast.errors import SceneError
from holdfast.model import checks
from holdfast.model.closure import Closure
from holdfast.model.grasp import Grasp
from holdfast.robots.sdf.frames import MODEL_FRAME, SdfFrames
from holdfast.robots.sdf.values import child_limit, child_number, switch, unit_vector
from holdfast.robots.sdf.vocabulary import sdf_notes
from holdfast.robots.urdf.document import Element, quoted
from holdfast.robots.urdf.robot import SDF_BALL, SDF_SCREW, Mimic, UrdfInertial, UrdfJoint, UrdfLink
from holdfast.robots.urdf.vocabulary import extension_notes, text_of
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array

TREE_KINDS = {
    "revolute": "revolute", "continuous": "continuous", "prismatic": "prismatic", "fixed": "fixed",
    "ball": SDF_BALL, "screw": SDF_SCREW, "universal": "revolute", "revolute2": "revolute",
}  # fmt: skip
LOOP_KINDS = {
    "revolute": "hinge", "continuous": "hinge", "prismatic": "slider", "fixed": "rigid", "ball": "ball",
    "screw": "screw", "universal": "universal", "revolute2": "universal",
}  # fmt: skip
AXES = {"fixed": (), "ball": (), "universal": ("axis", "axis2"), "revolute2": ("axis", "axis2")}
ENGINES_OF_JOINTS = ("ode", "simbody")
SQUARE_AXES = 1e-6  # largest cosine between the axes of a universal joint that closes a loop


@dataclass(frozen=True, eq=False)
class SdfJoint:
    """A joint as its file states it.

    Attributes:
        name: its name.
        kind: type in the file.
        parent: link or "world" on which it stands.
        child: link that it moves.
        on_parent: pose of the joint's frame in the parent.
        on_child: the same in the child.
        element: the <joint> element.
        notes: what was not read.
        axes: (3,) unit vectors in the joint's frame.
        drives: limits, dynamics and mimicry of each axis.
        pitch: translation along the axis per radian, for a screw [m/rad].
        fault: an error in axes or drives, which does not matter if the joint is locked.
    """

    name: str
    kind: str
    parent: str
    child: str
    on_parent: Pose
    on_child: Pose
    element: Element = field(repr=False)
    notes: tuple[str, ...]
    axes: tuple[Array, ...] = ()
    drives: tuple[dict[str, Any], ...] = ()
    pitch: float | None = None
    fault: SceneError | None = None


def sdf_joint(element: Element, frames: SdfFrames) -> SdfJoint:
    """Return a joint as its file states it.

    Raises:
        SceneError: its type is unknown, an end is none of the model, or something cannot be read.
    """
    notes = sdf_notes(element)
    for physics in (child for child in element.children if child.tag == "physics"):
        for one in (physics, *(engine for engine in physics.children if engine.tag in ENGINES_OF_JOINTS)):
            notes += [note for note in extension_notes(one, "sdf physics") if "must_be_loop_joint" not in note]
    name, kind = attributes.name(element), attributes.name(element, "type")
    if kind not in TREE_KINDS:
        raise element.refuse(
            f"type: expected one of {', '.join(TREE_KINDS)}, got {quoted(kind)}.{checks.did_you_mean(kind, TREE_KINDS)}"
        )
    ends = {side: element.required(side) for side in ("parent", "child")}
    parent, child = (frames.link(text_of(end), end) for end in ends.values())
    if child == "world" or child == parent:
        raise ends["child"].refuse(f"expected another link than the parent, and not the world, got {quoted(child)}")
    own: dict[str, Any] = {}
    try:
        stated = [element.required(tag) for tag in AXES.get(kind, ("axis",))]
        own["axes"] = tuple(_axis(axis, name, frames) for axis in stated)
        own["drives"] = tuple(_drive(axis, kind, notes) for axis in stated)
        if kind == "screw":
            own["pitch"] = child_number(element, "screw_thread_pitch") / (2 * math.pi)
    except SceneError as fault:
        own["fault"] = fault
    on_parent, on_child = (frames.between(link, name, element) for link in (parent, child))
    return SdfJoint(name, kind, parent, child, on_parent, on_child, element, tuple(notes), **own)


def must_close(element: Element) -> bool:
    """Return whether a joint closes a loop by Simbody's switch."""
    physics = element.first("physics")
    simbody = None if physics is None else physics.first("simbody")
    return switch(None if simbody is None else simbody.first("must_be_loop_joint"), False)


def _axis(axis: Element, joint: str, frames: SdfFrames) -> Array:
    """Return the unit vector of an axis in the joint's frame."""
    xyz = axis.first("xyz")
    if xyz is None:
        return np.array([0.0, 0.0, 1.0])
    in_frame = xyz.attributes.get("expressed_in", "")
    if not in_frame and switch(axis.first("use_parent_model_frame"), False):
        in_frame = MODEL_FRAME
    a = unit_vector(xyz)
    if not in_frame or in_frame == joint:
        return a
    turned = frames.between(joint, in_frame, xyz).R @ a
    return turned / np.linalg.norm(turned) + 0.0


def _drive(axis: Element, kind: str, notes: list[str]) -> dict[str, Any]:
    """Return limits, dynamics and mimicry of an axis; negative limits of rate and effort mean that there is none."""
    limit, dynamics, mimic = (axis.first(tag) for tag in ("limit", "dynamics", "mimic"))
    found: dict[str, Any] = {
        quantity: child_number(dynamics, tag, 0.0, at_least=0.0)
        for quantity, tag in (("damping", "damping"), ("friction", "friction"), ("stiffness", "spring_stiffness"))
    }
    found["rest"] = child_number(dynamics, "spring_reference", 0.0)
    low, high = child_limit(limit, "lower", -math.inf), child_limit(limit, "upper", math.inf)
    if low > high and limit is not None:
        raise limit.refuse(f"expected lower <= upper, got {low:g} and {high:g}")
    if kind != "continuous":
        found["position_limits"] = (low, high)
    for quantity, tag in (("rate_limit", "velocity"), ("effort_limit", "effort")):
        value = child_limit(limit, tag, math.inf)
        if value == 0.0 and limit is not None:
            notes.append(limit.message(f"{tag}: 0, taken as unlimited"))
        found[quantity] = value if value > 0.0 else math.inf
    if mimic is not None:
        multiplier = child_number(mimic, "multiplier")
        offset = child_number(mimic, "offset", 0.0) - multiplier * child_number(mimic, "reference", 0.0)
        leader, second = attributes.name(mimic, "joint"), mimic.attributes.get("axis", "axis") == "axis2"
        found["mimic"] = Mimic(f"{leader}.2" if second else leader, multiplier, offset)
    return found


def tree_joints(joint: SdfJoint) -> tuple[list[UrdfJoint], list[UrdfLink]]:
    """Return the joints of the tree that a joint becomes, one for each axis, and massless links between them.

    The frame of a moved link is that of its joint. If the child's own frame is elsewhere, a link with the joint's name
    is between, to which the child is fixed.
    """
    same = np.array_equal(joint.on_child.R, np.eye(3)) and not joint.on_child.p.any()
    if joint.kind == "fixed":
        origin = joint.on_parent if same else joint.on_parent @ joint.on_child.inverse()
        return [_tree_joint(joint, joint.name, "fixed", joint.parent, joint.child, origin)], []
    count = max(1, len(joint.axes))
    names = [joint.name] if count == 1 else [f"{joint.name}.{k + 1}" for k in range(count)]
    ends = [*names[:-1], joint.child if same else joint.name]
    starts, kind, joints = [joint.parent, *ends[:-1]], TREE_KINDS[joint.kind], []
    for k, (name, start, end) in enumerate(zip(names, starts, ends, strict=True)):
        own = joint.drives[k] if k < len(joint.drives) else {}
        axis = joint.axes[k] if k < len(joint.axes) else np.array([0.0, 0.0, 1.0])
        origin = joint.on_parent if k == 0 else Pose.identity()
        joints.append(_tree_joint(joint, name, kind, start, end, origin, axis, **own))
    if not same:
        joints.append(
            _tree_joint(
                joint, f"{joint.name} to {joint.child}", "fixed", joint.name, joint.child, joint.on_child.inverse()
            )
        )
    between = ends[:-1] + ([] if same else [joint.name])
    return joints, [massless(link, joint.element) for link in between]


def _tree_joint(
    joint: SdfJoint,
    name: str,
    kind: str,
    parent: str,
    child: str,
    origin: Pose,
    axis: Array | None = None,
    **drive: Any,
) -> UrdfJoint:
    """Return one joint of the tree; the first one of a joint has its notes."""
    along = np.array([0.0, 0.0, 1.0]) if axis is None else axis
    notes = joint.notes if parent == joint.parent else ()
    pitch, fault = (joint.pitch if kind == SDF_SCREW else None), None if kind == "fixed" else joint.fault
    return UrdfJoint(name, kind, parent, child, origin, along, joint.element, notes, pitch=pitch, fault=fault, **drive)


def massless(name: str, element: Element) -> UrdfLink:
    """Return a link without mass, which an element places."""
    return UrdfLink(name, UrdfInertial(0.0, np.zeros(3), np.zeros((3, 3)), element), element, ())


def closing(joint: SdfJoint) -> tuple[Closure, list[str]]:
    """Return the loop that a joint closes, and notes on its limits and dynamics, which a loop has not.

    Raises:
        SceneError: an axis is wrong, or those of a universal joint are not perpendicular.
    """
    if joint.fault is not None:
        raise joint.fault
    R, kind = np.eye(3), LOOP_KINDS[joint.kind]
    if joint.axes:
        x = joint.axes[0]
        y = joint.axes[1] if len(joint.axes) > 1 else np.roll(np.eye(3)[int(np.argmax(np.abs(x)))], 1)
        if len(joint.axes) > 1 and abs(x @ y) > SQUARE_AXES:
            raise joint.element.refuse("axis2: expected an axis perpendicular to the first one, as it closes a loop")
        y = y - (y @ x) * x
        y = y / np.linalg.norm(y)
        R = np.column_stack([x, y, np.cross(x, y)])
    turned = Pose(R, np.zeros(3))
    told = [
        name
        for drive in joint.drives
        for name in ("damping", "friction", "stiffness", "mimic", "position_limits")
        if (value := drive.get(name)) and value != (-math.inf, math.inf)
    ]
    notes = [joint.element.message(f"{', '.join(told)}: not read, since it closes a loop")] if told else []
    tip, frame = joint.on_parent @ turned, joint.on_child @ turned
    grasp = Grasp(kind, frame, pitch=joint.pitch)  # pyright: ignore[reportArgumentType]
    return Closure(joint.parent, joint.child, grasp, tip, joint.name), [*joint.notes, *notes]
