"""What a file says of links and joints outside of their own elements: springs, dampers, gravity, rotors, loops.

These stand in <gazebo>, <transmission> and <ros2_control>, and in elements of Drake. The model has springs, dampers and
rotors of joints. Gravity switched off and couplings of bodies are kept, to be refused where they matter.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from holdfast.errors import SceneError
from holdfast.robots.urdf.attributes import parsed
from holdfast.robots.urdf.document import Element, quoted
from holdfast.robots.urdf.robot import MOVABLE, PLANAR, WORLD_LINK, UrdfCoupling, UrdfJoint, UrdfLink
from holdfast.robots.urdf.vocabulary import VOCABULARY, extension_notes, hidden_notes, is_off, of_drive, text_of

GAZEBO_QUANTITIES = {
    "springStiffness": "stiffness",
    "spring_stiffness": "stiffness",
    "springReference": "rest",
    "spring_reference": "rest",
    "damping": "damping",
    "friction": "friction",
}
ENGINES = ("ode", "simbody", "bullet", "dart")  # parts of <physics>
SWITCHES = {"true": True, "1": True, "false": False, "0": False}
Statements = dict[str, list[tuple[float, Element]]]  # values with the elements that state them, by quantity


@dataclass(eq=False)
class Extensions:
    """What was found, by name of a link or joint; filled while the file is read.

    Attributes:
        links: the links of the file.
        joints: its joints.
        frames: link of each <frame> of Drake.
        values: what is said of each joint.
        rotors: inertia of each rotor, reflected to its joint; by joint, and by kind of element and name of the drive.
        weights: whether each link has weight.
        faults: the first error in what is said of a link or joint.
        notes: what was not read, by link or joint; of the robot under "".
        couplings: what couples bodies.
    """

    links: Mapping[str, UrdfLink]
    joints: Mapping[str, UrdfJoint]
    frames: Mapping[str, str]
    values: dict[str, Statements] = field(default_factory=dict)
    rotors: dict[str, dict[tuple[str, str], list[tuple[float, Element]]]] = field(default_factory=dict)
    weights: dict[str, list[tuple[float, Element]]] = field(default_factory=dict)
    faults: dict[str, SceneError] = field(default_factory=dict)
    notes: dict[str, list[str]] = field(default_factory=dict)
    couplings: list[UrdfCoupling] = field(default_factory=list)

    def note(self, about: str, notes: Iterable[str]) -> None:
        """Keep notes on a link or joint, or on the robot if it has none of that name."""
        known = about in self.links or about in self.joints
        self.notes.setdefault(about if known else "", []).extend(notes)

    @contextmanager
    def faults_of(self, names: Iterable[str]) -> Iterator[None]:
        """Keep an error in what is said of links or joints; it matters only if one of them moves."""
        try:
            yield
        except SceneError as fault:
            for name in names:
                self.faults.setdefault(name, fault)

    def couple(self, element: Element, joints: Iterable[str] = ()) -> None:
        """Keep a coupling of the links and joints that are named anywhere in an element, apart from its own name."""
        named, waiting = set(joints), [element]
        for one in waiting:  # the loop appends to this list
            waiting += [child for child in one.children if child.tag not in ("sensor", "plugin")]
            named |= {x for key, x in one.attributes.items() if one is not element or key not in ("name", "type")}
            named.update(one.stray)
        named = {name.rpartition("::")[2] for name in named}  # SDF puts the model before it
        links = {self.frames.get(name, name) for name in named} & {*self.links, WORLD_LINK}
        self.couplings.append(UrdfCoupling(element, frozenset(links), frozenset(named & self.joints.keys())))


def gazebo(found: Extensions, element: Element) -> None:
    """Read a <gazebo> element."""
    about = element.attributes.get("reference", "")
    found.note(about, extension_notes(element, "gazebo"))
    for child in element.children:
        effect = VOCABULARY["gazebo"].effect(child.tag)
        if child.tag == "sensor":
            found.note(about, hidden_notes(child))
        elif effect == "refused":
            found.couple(child)
        elif effect == "read" and child.tag in ("gravity", "turnGravityOff"):
            with found.faults_of([about]):
                gravity(found, child, about)
        elif effect == "read" and child.tag in (*GAZEBO_QUANTITIES, "axis", "dynamics", "physics"):
            with found.faults_of([about]):
                _of_joint(found, child, about)


def gravity(found: Extensions, element: Element, link: str) -> None:
    """Read a switch of gravity."""
    word = text_of(element).lower()
    if link not in found.links:
        if (word in SWITCHES) and SWITCHES[word] != (element.tag == "gravity"):
            found.note(
                "", [element.message("gravity off: expected the name of a link in reference=, got none; not read")]
            )
        elif word not in SWITCHES:
            found.note("", [element.message("not read; try gravity= of the chain")])
        return
    on = SWITCHES.get(word)
    if on is None:
        raise element.refuse(f"expected true or false, got {quoted(text_of(element))}")
    found.weights.setdefault(link, []).append((float(on == (element.tag == "gravity")), element))


def _of_joint(found: Extensions, element: Element, joint: str) -> None:
    """Read springs, dampers and friction of a joint, as Gazebo writes them or as SDF does."""
    tag = element.tag
    if tag in GAZEBO_QUANTITIES:
        _value(found, element, joint, GAZEBO_QUANTITIES[tag], text_of(element))
    elif tag in ("axis", "dynamics"):
        found.note(joint, extension_notes(element, f"sdf {tag}"))
        for key, stated in element.attributes.items():
            if tag == "dynamics" and key in GAZEBO_QUANTITIES:
                _value(found, element, joint, GAZEBO_QUANTITIES[key], stated)
        for child in element.children:
            if child.tag == "mimic":
                found.couple(child, [joint])
            elif VOCABULARY[f"sdf {tag}"].effect(child.tag) == "read":
                _of_joint(found, child, joint)
    else:  # physics, and the engines in it
        found.note(joint, extension_notes(element, "sdf physics"))
        for child in element.children:
            if child.tag in GAZEBO_QUANTITIES or child.tag in ENGINES:
                _of_joint(found, child, joint)


def _value(found: Extensions, element: Element, joint: str, quantity: str, stated: str) -> None:
    """Keep one number that is stated of a joint."""
    if joint not in found.joints:
        if not is_off(element):
            found.note("", [element.message(f"not read, since there is no joint {quoted(joint)}")])
        return
    (value,) = parsed(element, element.tag, stated)
    if value < 0.0 and quantity != "rest":
        raise element.refuse(f"expected >= 0, got {value!r}")
    found.values.setdefault(joint, {}).setdefault(quantity, []).append((value, element))


def agreed(stated: list[tuple[float, Element]], what: str) -> float:
    """Return the value of which several statements must agree.

    Raises:
        SceneError: they do not.
    """
    (value, first), *others = stated
    for other, element in others:
        if other != value:
            raise element.refuse(f"expected one {what}, got {other!r} here, and {value!r} in line {first.line}")
    return value


def with_extensions(found: Extensions) -> tuple[list[UrdfLink], list[UrdfJoint]]:
    """Return the links and joints with what was found of them."""
    return [_link(found, link) for link in found.links.values()], [_joint(found, one) for one in found.joints.values()]


def _link(found: Extensions, link: UrdfLink) -> UrdfLink:
    fault, weightless = link.fault or found.faults.get(link.name), None
    try:
        stated = found.weights.get(link.name, [(1.0, link.element)])
        weightless = None if agreed(stated, "switch of gravity") else stated[0][1]
    except SceneError as disagreement:
        fault = fault or disagreement
    return replace(link, notes=(*link.notes, *found.notes.get(link.name, ())), fault=fault, weightless=weightless)


def _armature(rotors: Mapping[tuple[str, str], list[tuple[float, Element]]]) -> float:
    """Return the sum of a joint's rotors; elements of several kinds describe the same drives.

    Raises:
        SceneError: they disagree, or it is not clear whether two rotors are the same.
    """
    totals: dict[str, float] = {}
    for (kind, name), said in rotors.items():
        if kind in totals and not all(name for other, name in rotors if other == kind):
            raise said[0][1].refuse("expected one rotor, or actuators with names, since several rotors add up")
        totals[kind] = totals.get(kind, 0.0) + agreed(said, "rotor inertia")
    first, *others = [*totals.values()] or [0.0]
    if not all(math.isclose(first, other, rel_tol=1e-9) for other in others):
        shown = ", ".join(f"{total:g} in <{kind}>" for kind, total in totals.items())
        raise next(iter(rotors.values()))[0][1].refuse(f"expected one rotor inertia at the joint, got {shown}")
    return first


def _joint(found: Extensions, joint: UrdfJoint) -> UrdfJoint:
    stated, rotors = found.values.get(joint.name, {}), found.rotors.get(joint.name, {})
    notes, fault, values = [*joint.notes, *found.notes.get(joint.name, ())], joint.fault, {}
    if joint.kind == PLANAR and (stated or rotors):
        notes.append(
            joint.element.message(f"{', '.join([*stated, *(['rotor'] if rotors else [])])}: ignored for a planar joint")
        )
    if joint.kind in MOVABLE:
        fault = fault or found.faults.get(joint.name)
        try:
            own = {quantity: getattr(joint, quantity) for quantity in (*stated, "armature")}
            stated = {
                name: [*([(own[name], joint.element)] if own[name] else []), *said] for name, said in stated.items()
            }
            values = {quantity: agreed(said, quantity) for quantity, said in stated.items()}
            values["armature"] = own["armature"] + _armature(rotors)
        except SceneError as disagreement:
            fault = fault or disagreement
    return replace(joint, notes=tuple(notes), fault=fault, **values)


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


class DriveNumber(NamedTuple):
    """A number that is stated of a drive."""

    quantity: str
    value: float
    element: Element


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


def _said(element: Element) -> list[DriveNumber]:
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
            said.append(DriveNumber(quantity, value, where))
    return said
