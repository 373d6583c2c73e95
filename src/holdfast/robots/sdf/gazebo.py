"""Joints that a URDF file states for Gazebo, in SDF, where they close loops of its tree."""

from __future__ import annotations

from dataclasses import replace

from holdfast.errors import SceneError
from holdfast.model.closure import Closure
from holdfast.robots.sdf.frames import MODEL_FRAME, SdfFrames
from holdfast.robots.sdf.joints import closing, sdf_joint
from holdfast.robots.sdf.values import pose_in
from holdfast.robots.urdf.document import Element
from holdfast.robots.urdf.robot import WORLD_LINK, UrdfCoupling, UrdfRobot
from holdfast.spatial.pose import Pose

ENDS_OF_JOINTS = ("parent", "child")


def with_gazebo_loops(robot: UrdfRobot) -> UrdfRobot:
    """Return a robot whose loops by joints of Gazebo's are closures, as they stand where all its joints are at 0.

    A joint that cannot be read stays a coupling that no arm can have. O(loops links).
    """
    couplings, notes = [], [*robot.notes]
    for coupling in robot.couplings:
        if coupling.element.tag == "joint" and coupling.closure is None and len(coupling.links) == 2:
            closure, told = _closure(robot, coupling)
            notes += told
            coupling = replace(coupling, closure=closure)
        couplings.append(coupling)
    return replace(robot, couplings=tuple(couplings), notes=tuple(notes))


def _closure(robot: UrdfRobot, coupling: UrdfCoupling) -> tuple[Closure | None, list[str]]:
    """Return the closure that a joint is, and notes on it; None if it cannot be read."""
    element = _within_model(coupling.element)
    pose, child = element.first("pose"), element.first("child")
    name = element.attributes.get("name", "")
    if not name or child is None or not child.stray or name in robot.links:
        return None, []
    above = {one.child: (one.parent, one.origin) for one in robot.joints.values()}
    above |= {robot.root: (MODEL_FRAME, Pose.identity()), MODEL_FRAME: (WORLD_LINK, Pose.identity())}
    try:
        stated = "" if pose is None else pose.attributes.get("relative_to", "")
        above[name] = (stated or child.stray[0], pose_in(pose))
        links = {link: found.element for link, found in robot.links.items()}
        return closing(sdf_joint(element, SdfFrames(links, {}, above)))
    except SceneError:
        return None, []


def _within_model(joint: Element) -> Element:
    """Return a joint whose ends have no model's name before them."""
    found = replace(joint, children=[])
    for child in joint.children:
        short = [text.rpartition("::")[2] for text in child.stray] if child.tag in ENDS_OF_JOINTS else child.stray
        found.children.append(replace(child, stray=short, parent=found))
    return found
