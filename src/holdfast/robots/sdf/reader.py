"""The reader of SDF files, which returns the same tree of links and joints as that of URDF files."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import holdfast.robots.urdf.attributes as attributes
from holdfast.robots.sdf.frames import MODEL_FRAME, SdfFrames, sdf_frames
from holdfast.robots.sdf.joints import SdfJoint, closing, massless, must_close, sdf_joint, tree_joints
from holdfast.robots.sdf.shapes import drawn
from holdfast.robots.sdf.values import child_number, pose_in, switch
from holdfast.robots.sdf.vocabulary import sdf_notes
from holdfast.robots.urdf.document import Element, listed, quoted
from holdfast.robots.urdf.inertial import link_inertial
from holdfast.robots.urdf.robot import WORLD_LINK, UrdfCoupling, UrdfInertial, UrdfJoint, UrdfLink, UrdfRobot
from holdfast.robots.urdf.source import UrdfSource
from holdfast.robots.urdf.tree import by_name, refuse_circles, root_of

VERSIONS = tuple(f"1.{k}" for k in range(6, 13))


def sdf_robot(root: Element, source: UrdfSource) -> UrdfRobot:
    """Return the links and joints of the one model in an SDF file.

    A model without a joint to the world stands on its root link, wherever its <pose> is. If its joints go round, this
    is the canonical link, and the joint above it closes the loop.

    Args:
        root: the <sdf> element.
        source: where it is from.

    Raises:
        SceneError: the file has an error, another version, several models, or one that includes others.
    """
    version = root.attributes.get("version", "")
    if version not in VERSIONS:
        raise root.refuse(
            f"version: expected one of {', '.join(VERSIONS)}, got {quoted(version)}; try `gz sdf -p`, which writes the"
            " newest one"
        )
    notes = [*source.notes, *sdf_notes(root)]
    model, of_world = _model(root)
    notes += [*of_world, *sdf_notes(model)]
    if switch(model.first("static"), False):
        notes.append(model.required("static").message("not read: its joints move, as far as they are not locked"))
    frames = sdf_frames(model)
    links = [_link(child) for child in model.children if child.tag == "link"]
    elements = sorted((child for child in model.children if child.tag == "joint"), key=must_close)
    stated = [sdf_joint(child, frames) for child in elements]
    hanging: dict[str, SdfJoint] = {}
    loops = [joint for joint in stated if hanging.setdefault(joint.child, joint) is not joint]
    if links and {link.name for link in links} <= hanging.keys():
        on_world = any(joint.parent == WORLD_LINK for joint in hanging.values())
        loops += [] if on_world else [hanging.pop(frames.link(MODEL_FRAME, model))]
    joints: list[UrdfJoint] = []
    if any(joint.parent == WORLD_LINK for joint in hanging.values()):
        links.insert(0, massless(WORLD_LINK, model))
    elif any(joint.parent == WORLD_LINK for joint in loops):
        raise loops[0].element.refuse("parent: expected a joint between the world and the root link before it")
    for joint in hanging.values():
        own, between = tree_joints(joint)
        joints, links = [*joints, *own], [*links, *between]
    for child in model.children:
        if child.tag == "frame":
            notes += sdf_notes(child)
            own, link = _frame(child, frames)
            joints.append(own)
            links.append(link)
    couplings = []
    for joint in loops:
        closure, told = closing(joint)
        notes += told
        couplings.append(UrdfCoupling(joint.element, frozenset({joint.parent, joint.child}), closure=closure))
    by_link, by_joint = by_name(links), by_name(_led(joints))
    name = attributes.name(model)
    folder = "" if source.folder is None else str(source.folder.resolve())
    above = root_of(model, by_link, by_joint)
    robot = UrdfRobot(name, by_link, by_joint, above, model, tuple(notes), folder, source.packages, tuple(couplings))
    refuse_circles(robot)
    return robot


def _model(root: Element) -> tuple[Element, list[str]]:
    """Return the one model of a file, and notes on the world around it."""
    worlds = [child for child in root.children if child.tag == "world"]
    models = [child for child in root.children if child.tag == "model"]
    notes = [note for world in worlds for note in sdf_notes(world)]
    models += [child for world in worlds for child in world.children if child.tag == "model"]
    if len(models) != 1:
        names = listed(attributes.name(model) for model in models)
        raise root.refuse(f"expected one <model>, got {names}; try a file with one of them")
    return models[0], notes


def _link(element: Element) -> UrdfLink:
    """Return a link, which has 1 kg and 1 kg m^2 without <inertial>, as the format says."""
    notes, fault = sdf_notes(element), None
    inertial, name = element.first("inertial"), attributes.name(element)
    if inertial is None:
        notes.append(element.message("no <inertial>, taken as 1 kg and 1 kg m^2, the format's default"))
        weight = UrdfInertial(1.0, np.zeros(3), np.eye(3), element)
    else:
        if inertial.attributes.get("auto", "false").lower() not in ("false", "0"):
            fault = inertial.refuse("auto: inertia of the shapes is not computed; try <mass> and <inertia>")
        weight = _inertial(inertial, notes)
    gravity = element.first("gravity")
    weightless = None if gravity is None or switch(gravity, True) else gravity
    return UrdfLink(name, weight, drawn(element), tuple(notes), fault, weightless)


def _inertial(element: Element, notes: list[str]) -> UrdfInertial:
    """Return the mass, mass centre and inertia in link axes; what is missing is 1 kg, 1 kg m^2 or 0 by the format."""
    mass, moments = child_number(element, "mass", 1.0), element.first("inertia")
    xx, yy, zz = (child_number(moments, key, 1.0) for key in ("ixx", "iyy", "izz"))
    xy, xz, yz = (child_number(moments, key, 0.0) for key in ("ixy", "ixz", "iyz"))
    J = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    pose = element.first("pose")
    if pose is not None and pose.attributes.get("relative_to"):
        raise pose.refuse("relative_to: expected none, as the pose of an inertia is in its link")
    return link_inertial(element, mass, J, pose_in(pose), notes)


def _frame(element: Element, frames: SdfFrames) -> tuple[UrdfJoint, UrdfLink]:
    """Return a frame as a massless link that is fixed to the link to which it is attached."""
    name = attributes.name(element)
    link = frames.link(name, element)
    origin = frames.between(link, name, element)
    fixed = UrdfJoint(f"frame {name}", "fixed", link, name, origin, np.array([0.0, 0.0, 1.0]), element, ())
    return fixed, massless(name, element)


def _led(joints: list[UrdfJoint]) -> list[UrdfJoint]:
    """Return joints that mimic the first axis of a universal joint by the name of the joint that it became."""
    names = {joint.name for joint in joints}
    found = []
    for joint in joints:
        mimic = joint.mimic
        if mimic is not None and mimic.joint not in names and f"{mimic.joint}.1" in names:
            joint = replace(joint, mimic=replace(mimic, joint=f"{mimic.joint}.1"))
        found.append(joint)
    return found
