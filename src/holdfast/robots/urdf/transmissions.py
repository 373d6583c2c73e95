"""The rotors of drives: inertia and gear ratio in <transmission> and <ros2_control>, or at the joint.

A rotor that turns n times as fast as its joint adds n^2 times its inertia to the joint, which is the joint's armature.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

from holdfast.robots.urdf.attributes import parsed
from holdfast.robots.urdf.document import Element, quoted
from holdfast.robots.urdf.extensions import Extensions, agreed
from holdfast.robots.urdf.vocabulary import VOCABULARY, extension_notes, of_drive, text_of


class _Said(NamedTuple):
    """A number that is stated of a drive."""

    quantity: str
    value: float
    element: Element


def ros2_control(found: Extensions, element: Element) -> None:
    """Read a <ros2_control> element: parameters of its joints, and its transmissions."""
    joints = {child.attributes.get("name", ""): child for child in element.children if child.tag == "joint"}
    driven = set[str]()
    for child in element.children:
        if child.tag == "transmission":
            driven |= transmission(found, child, joints)
        elif child.tag == "hardware" and any(one.quantity != "ratio" for one in _said(child)):
            found.note("", [child.message("rotor inertia: expected it in a joint or a transmission; not read")])
    for name, joint in joints.items():
        if name not in driven:
            with found.faults_of([name]):
                _add_rotors(found, joint, name, [], [joint])
        follows = any(p.attributes.get("name") == "mimic" for p in joint.children)
        if follows and name in found.joints and found.joints[name].mimic is None:
            found.note(name, [joint.message("param 'mimic': not read; try <mimic> in the joint")])
        found.note(name, extension_notes(joint, "transmission part"))
    found.note("", extension_notes(element, "ros2_control"))


def drive(found: Extensions, element: Element, joint: str) -> None:
    """Read what a <joint> says of its drive, or a <gazebo> element of a joint's."""
    with found.faults_of([joint]):
        _add_rotors(found, element, joint, [child for child in element.children if child.tag == "actuator"], [element])


def transmission(found: Extensions, element: Element, described: dict[str, Element]) -> set[str]:
    """Read a <transmission>, and return the names of its joints.

    Args:
        found: where to keep what is read.
        element: the element.
        described: elements of ros2_control that describe joints, by joint.
    """
    parts = [child for child in element.children if child.tag in VOCABULARY["transmission"].extensions]
    joints = [part for part in parts if part.tag.lower().endswith("joint")]
    actuators = [part for part in parts if part not in joints]
    names = {joint.attributes.get("name", "") for joint in joints}
    about = next(iter(names)) if len(names) == 1 else ""
    shared = [element, *joints, *(described[name] for name in names if name in described)]
    found.note(about, extension_notes(element, "transmission"))
    for part in parts:
        found.note(about, extension_notes(part, "transmission part"))
    with found.faults_of(names):
        said = [one for part in (*shared, *actuators) for one in _said(part)]
        if len(names) == 1:
            _add_rotors(found, element, about, actuators, shared)
        elif any(one.value and one.quantity != "ratio" for one in said):
            found.couple(element, names)
    return names


def _add_rotors(
    found: Extensions, element: Element, joint: str, actuators: list[Element], shared: Iterable[Element]
) -> None:
    """Keep the reflected inertias of the actuators of one joint; of the drive as a whole if no actuator has one."""
    common = [one for part in shared for one in _said(part)]
    own = {id(part): _said(part) for part in actuators}
    turning = [part for part in actuators if any(one.quantity != "ratio" for one in own[id(part)])]
    drives = [(part, [*own[id(part)], *(one for one in common if one.quantity == "ratio")]) for part in turning]
    if not turning:
        drives = [(element, [*common, *(one for said in own.values() for one in said)])]
    for part, said in drives:
        by: dict[str, list[tuple[float, Element]]] = {"inertia": [], "armature": [], "ratio": []}
        for one in said:
            by[one.quantity].append((one.value, one.element))
        if not any(value for value, _ in by["inertia"] + by["armature"]):
            continue
        if joint not in found.joints:
            found.note("", [part.message(f"rotor inertia: not read, since there is no joint {quoted(joint)}")])
            continue
        ratios = [(abs(value), where) for value, where in by["ratio"] if abs(value) != 1.0]
        ratio = agreed(ratios, "gear ratio") if ratios else 1.0
        if ratio == 0.0:
            raise ratios[0][1].refuse("expected a gear ratio, got 0")
        reflected = agreed(by["inertia"], "rotor inertia") * ratio**2 if by["inertia"] else 0.0
        armature = agreed(by["armature"], "armature") if by["armature"] else reflected
        if by["inertia"] and not math.isclose(armature, reflected, rel_tol=1e-9):
            raise part.refuse(f"expected armature = inertia ratio^2 = {reflected:g}, got {armature:g}")
        name = part.attributes.get("name", "") if part.tag != "joint" else joint
        found.rotors.setdefault(joint, {}).setdefault((_kind(part), name), []).append((armature, part))


def _kind(element: Element) -> str:
    """Return the name of the element of <robot> in which an element stands."""
    while element.parent is not None and element.parent.parent is not None:
        element = element.parent
    return element.tag


def _said(element: Element) -> list[_Said]:
    """Return what an element says of a drive: in its attributes, in its children, or as parameters of ros2_control."""
    texts = [(key, stated, element) for key, stated in element.attributes.items()]
    for child in element.children:
        texts.append((child.attributes.get("name", "") if child.tag == "param" else child.tag, text_of(child), child))
    said = []
    for name, stated, where in texts:
        if quantity := of_drive(name):
            (value,) = parsed(where, name, stated)
            if value < 0.0 and quantity != "ratio":
                raise where.refuse(f"{name}: expected >= 0, got {value!r}")
            said.append(_Said(quantity, value, where))
    return said
