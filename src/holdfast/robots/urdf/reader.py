"""The reader of URDF files, which returns a tree of links and joints; planar joints become three joints."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from os import PathLike
from typing import Any

import numpy as np

import holdfast.robots.urdf.attributes as attributes
import holdfast.robots.urdf.extensions as extensions
from holdfast.errors import SceneError
from holdfast.model import checks
from holdfast.robots.sdf.gazebo import with_gazebo_loops
from holdfast.robots.sdf.reader import sdf_robot
from holdfast.robots.urdf.document import Element, parse_document, quoted
from holdfast.robots.urdf.inertial import link_inertial
from holdfast.robots.urdf.robot import (
    MOVABLE,
    PLANAR,
    TYPES,
    UNSUPPORTED,
    Mimic,
    UrdfInertial,
    UrdfJoint,
    UrdfLink,
    UrdfRobot,
)
from holdfast.robots.urdf.source import UrdfSource, read_source
from holdfast.robots.urdf.tree import by_name, refuse_circles, root_of
from holdfast.robots.urdf.vocabulary import VOCABULARY, extension_notes, hidden_notes, unread_notes
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.spatial.vector import cross

UNREAD_OF_PLANAR = ("limit", "dynamics", "mimic")


def read_urdf(
    path_or_text: str | PathLike[str] | UrdfSource,
    *,
    xacro_args: Mapping[str, str] | None = None,
    trust_xacro: bool = False,
    packages: Mapping[str, str | PathLike[str]] | None = None,
) -> UrdfRobot:
    """Return the tree of links and joints that a URDF or SDF file describes. O(links + joints).

    All links and joints are read. Masses, inertias, limits and drives are checked only when they are used. Angles
    within 1e-12 rad of a multiple of pi/2 are rounded to that multiple. A planar joint becomes two prismatic joints and
    a revolute one. An SDF file (1.6 to 1.12) has one model; a universal joint becomes two revolute ones, and a joint
    whose child hangs on another joint already closes a loop.

    Args:
        path_or_text: a file, or the text itself (which begins with `<`). A file whose name ends
            in `.xacro` is expanded first (extra `robots`), if `trust_xacro` is true.
        xacro_args: values of the file's <xacro:arg> elements by name.
        trust_xacro: whether to expand a `.xacro` file. This runs the Python expressions in it and in the files that it
            includes, with all permissions of the user.
        packages: folders of packages by name, for `$(find name)` and `package://name`. Others are searched beside the
            file's own package, in its workspace and in ROS's environment variables.

    Raises:
        SceneError: the file has an error (the message gives file, line and element), or is a .xacro file and
            `trust_xacro` is False.
        MissingExtra: the file is a .xacro file, and xacrodoc is not installed.
    """
    source = read_source(path_or_text, xacro_args, trust_xacro, packages)
    root = parse_document(source.text, source.name)
    if root.tag == "sdf":
        return sdf_robot(root, source)
    if root.tag != "robot":
        raise root.refuse("expected <robot> as the outermost element, or <sdf>")
    stated = by_name([_joint(element) for element in root.children if element.tag in ("joint", "drake:joint")])
    found = _extensions(root, by_name([_link(element) for element in root.children if element.tag == "link"]), stated)
    bodies, hinges = extensions.with_extensions(found)
    notes = (*source.notes, *unread_notes(root), *found.notes.get("", ()))
    parts = [taken_apart(joint) if joint.kind == PLANAR else ([joint], []) for joint in hinges]
    links = by_name([*bodies, *(link for _, between in parts for link in between)])
    joints = by_name([joint for apart, _ in parts for joint in apart])
    folder = "" if source.folder is None else str(source.folder.resolve())
    name = attributes.name(root) if root.attributes.get("name", "").strip() else ""
    couplings = tuple(found.couplings)
    robot = UrdfRobot(
        name, links, joints, root_of(root, links, joints), root, notes, folder, source.packages, couplings
    )
    refuse_circles(robot)
    return with_gazebo_loops(robot)


def _extensions(root: Element, links: Mapping[str, UrdfLink], joints: Mapping[str, UrdfJoint]) -> extensions.Extensions:
    """Return what the file says of links and joints outside of their own elements."""
    named = [(frame.attributes.get("name", ""), frame) for frame in root.children if frame.tag == "frame"]
    found = extensions.Extensions(links, joints, {name: frame.attributes.get("link", "") for name, frame in named})
    for element in root.children:
        if VOCABULARY["robot"].effect(element.tag) == "refused":
            found.couple(element)
        elif element.tag == "gazebo":
            extensions.gazebo(found, element)
            extensions.drive(found, element, element.attributes.get("reference", ""))
        elif element.tag == "transmission":
            extensions.transmission(found, element, {})
        elif element.tag == "ros2_control":
            extensions.ros2_control(found, element)
        elif element.tag == "sensor":
            found.note("", hidden_notes(element))
        elif element.tag == "mujoco":
            found.note("", [*extension_notes(element, "mujoco"), *_of_compiler(element)])
    for joint in joints.values():
        extensions.drive(found, joint.element, joint.name)
    for link in links.values():
        for element in link.element.children:
            if element.tag in VOCABULARY["link"].extensions:
                with found.faults_of([link.name]):
                    extensions.gravity(found, element, link.name)
    return found


def _of_compiler(element: Element) -> list[str]:
    """Return notes on settings of MuJoCo's compiler that change masses."""
    settings = VOCABULARY["mujoco compiler"].noted
    given = [(one, name) for one in element.children for name in one.attributes if name in settings]
    return [one.message(f"{name}: changes masses, but is not read") for one, name in given]


def _link(element: Element) -> UrdfLink:
    """Return a link, which is massless without <inertial>."""
    notes = list(unread_notes(element))
    inertial, weight, fault = element.first("inertial"), None, None
    if inertial is not None and (missing := [tag for tag in ("mass", "inertia") if inertial.first(tag) is None]):
        weight = UrdfInertial(1.0, np.zeros(3), np.zeros((3, 3)), inertial)
        fault = inertial.refuse(f"expected <{missing[0]}>, got none")  # matters only on a body that moves
    elif inertial is not None:
        weight = _inertial(inertial, notes)
    return UrdfLink(attributes.name(element), weight, element, tuple(notes), fault)


def _inertial(element: Element, notes: list[str]) -> UrdfInertial:
    """Return the mass, mass centre and inertia in link axes."""
    mass = attributes.number(element.required("mass"), "value", size=attributes.LARGEST_VALUE)
    moments = element.required("inertia")
    return link_inertial(element, mass, _symmetric(moments), attributes.pose(element.first("origin")), notes)


def _symmetric(moments: Element) -> Array:
    """Return the (3, 3) inertia matrix; entries below the diagonal are optional, and must agree with those above."""
    xx, xy, xz, yy, yz, zz = (
        attributes.number(moments, key, size=attributes.LARGEST_VALUE)
        for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    )
    for mirror, key, value in (("iyx", "ixy", xy), ("izx", "ixz", xz), ("izy", "iyz", yz)):
        if (again := attributes.number(moments, mirror, value)) != value:
            raise moments.refuse(f"{mirror}: expected {key}, {value!r}, since an inertia is symmetric, got {again!r}")
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _joint(element: Element) -> UrdfJoint:
    """Return a joint; the axis, limits and friction of a fixed joint have no meaning and are not read.

    An error in the axis, the limits or the drive is kept, since it does not matter if the joint is locked.
    """
    notes = list(unread_notes(element))
    kind = _kind(element)
    axis = np.array([1.0, 0.0, 0.0])
    drive: dict[str, Any] = {}
    try:
        if kind in MOVABLE:
            drive["mimic"] = _mimic(element)
        if kind in MOVABLE or kind == PLANAR:
            axis = _axis(element, notes)
        if kind in MOVABLE:
            drive |= {**_dynamics(element), **_limits(element, kind, notes)}
    except SceneError as fault:
        drive["fault"] = fault
    return UrdfJoint(
        name=attributes.name(element),
        kind=kind,
        parent=attributes.name(element.required("parent"), "link"),
        child=attributes.name(element.required("child"), "link"),
        origin=attributes.pose(element.first("origin")),
        axis=axis,
        element=element,
        notes=tuple(notes),
        **drive,
    )


def _kind(element: Element) -> str:
    """Return the joint's type, one of those defined by URDF or its dialects."""
    kind = attributes.name(element, "type")
    if element.tag != "joint":
        return f"{element.tag.partition(':')[0]}:{kind}"  # a type of Drake's own
    known = (*TYPES, PLANAR, "fixed", *UNSUPPORTED)
    if kind not in known:
        raise element.refuse(
            f"type: expected one of {', '.join(known)}, got {quoted(kind)}.{checks.did_you_mean(kind, known)}"
        )
    return kind


def _axis(element: Element, notes: list[str]) -> np.ndarray:
    """Return the unit axis, which is x by default, as the format prescribes."""
    if (axis := element.first("axis")) is not None:
        return attributes.axis(axis)
    notes.append(element.message("no <axis>, taken as 1 0 0"))
    return np.array([1.0, 0.0, 0.0])


def _dynamics(element: Element) -> dict[str, float]:
    """Return damping, Coulomb friction, armature, and a spring's stiffness and reference, if the file gives any."""
    if (dynamics := element.first("dynamics")) is None:
        return {}
    keys = {"damping": "damping", "friction": "friction", "stiffness": "spring_stiffness", "armature": "armature"}
    sizes = {name: attributes.number(dynamics, key, 0.0, at_least=0.0) for name, key in keys.items()}
    return {**sizes, "rest": attributes.number(dynamics, "spring_reference", 0.0)}


def _mimic(element: Element) -> Mimic | None:
    """Return the joint that this joint mimics, or None."""
    if (mimic := element.first("mimic") or element.first("drake:mimic")) is None:
        return None
    followed = attributes.name(mimic, "joint")
    multiplier, offset = attributes.number(mimic, "multiplier", 1.0), attributes.number(mimic, "offset", 0.0)
    return Mimic(followed, multiplier, offset)


def _limits(element: Element, kind: str, notes: list[str]) -> dict[str, Any]:
    """Return the limits of position, rate and effort, as far as the file gives them.

    Programs that write URDF files often use zeros for unknown values. Because a joint that cannot move would be a fixed
    joint, a rate, an effort or a range of zero means that there is no limit, and causes a note.
    """
    limit = element.first("limit")
    if limit is None:
        if kind != "continuous":
            notes.append(element.message("no <limit>, taken as unlimited"))
        return {}
    found = {f"{name}_limit": _bound(limit, key, notes) for name, key in (("rate", "velocity"), ("effort", "effort"))}
    lower, upper = attributes.limit(limit, "lower"), attributes.limit(limit, "upper")
    if kind == "continuous":
        if lower is not None or upper is not None:
            notes.append(limit.message("lower, upper: not read, since a continuous joint has none"))
        return found
    low, high = lower or 0.0, upper or 0.0  # the format defines 0 for a missing bound
    if low == high == 0.0:
        notes.append(limit.message("lower, upper: a range of 0, taken as unlimited"))
        return found
    if low > high:
        raise limit.refuse(f"expected lower <= upper, got {low:g} and {high:g}")
    return {**found, "position_limits": (low, high)}


def _bound(limit: Element, key: str, notes: list[str]) -> float:
    """Return the largest rate or effort, which is infinite if it is missing or zero."""
    value = attributes.limit(limit, key)
    if value is None or value == 0.0:
        notes.append(limit.message(f"{key}: {'missing' if value is None else '0'}, taken as unlimited"))
        return math.inf
    if value < 0:
        raise limit.refuse(f"{key}: expected >= 0, got {value!r}")
    return value


def taken_apart(joint: UrdfJoint) -> tuple[list[UrdfJoint], list[UrdfLink]]:
    """Return the three joints with one degree of freedom that replace a planar joint, and two massless links between.

    A planar joint 'name' becomes the prismatic joints 'name.1' and 'name.2' and the revolute joint 'name.3' about the
    normal. The prismatic joints are along the child's x and y for a normal along z, along y and z for x, and along z
    and x for y; for any other normal, they are along the nearest such directions in the plane.
    """
    normal, name, element = joint.axis, joint.name, joint.element
    along = np.eye(3)[(int(np.argmax(np.abs(normal))) + 1) % 3]
    first = along - (normal @ along) * normal
    first = first / np.linalg.norm(first)
    unread = [tag for tag in UNREAD_OF_PLANAR if element.first(tag) is not None]
    notes = [*joint.notes, element.message("planar, read as two prismatic joints and a revolute joint")]
    notes += [element.message(f"{', '.join(unread)}: ignored for a planar joint")] if unread else []
    between = [f"{name}.1", f"{name}.2"]
    links = [joint.parent, *between, joint.child]
    moves = [("prismatic", first), ("prismatic", cross(normal, first)), ("continuous", normal)]
    joints = [
        replace(
            joint,
            name=f"{name}.{k + 1}",
            kind=kind,
            parent=links[k],
            child=links[k + 1],
            origin=joint.origin if k == 0 else Pose.identity(),
            axis=axis + 0.0,
            notes=tuple(notes) if k == 0 else (),
        )
        for k, (kind, axis) in enumerate(moves)
    ]
    weightless = UrdfInertial(0.0, np.zeros(3), np.zeros((3, 3)), element)
    return joints, [UrdfLink(link, weightless, element, ()) for link in between]
