"""The words of URDF: which are read, which cannot matter for dynamics, which are refused, and the rest.

Nothing is passed over in silence: a word that looks like a misspelt one is refused, one
that closes a loop or adds a spring is refused, and any other unknown word becomes a note.
"""

from __future__ import annotations

import difflib
from typing import NamedTuple

from holdfast.robots.urdf.document import Element, quoted, shortened


class Words(NamedTuple):
    """The attributes and children that an element may have.

    Attributes:
        attributes: those that are read.
        children: those that are read, each at most once except in <robot>.
        skipped: attributes and children that cannot matter for dynamics: pictures, contacts, safety
            and simulators' own words.
    """

    attributes: tuple[str, ...]
    children: tuple[str, ...] = ()
    skipped: tuple[str, ...] = ()


_CHECKED = ("self_filter", "collision_checking", "self_collision_checking")
WORDS = {
    "robot": Words(
        ("name",),
        ("link", "joint"),
        ("version", "material", "gazebo", "transmission", "ros2_control", "sensor", "mujoco"),
    ),
    "link": Words(
        ("name",),
        ("inertial",),
        ("type", "visual", "collision", "contact", "surface", "concave", "sensor", *_CHECKED),
    ),
    "inertial": Words((), ("origin", "mass", "inertia")),
    "mass": Words(("value",)),
    "inertia": Words(("ixx", "ixy", "ixz", "iyy", "iyz", "izz", "iyx", "izx", "izy")),
    "origin": Words(("xyz", "rpy")),
    "joint": Words(
        ("name", "type"),
        ("parent", "child", "origin", "axis", "limit", "dynamics", "mimic"),
        ("calibration", "safety_controller", "hardwareInterface", "dont_collapse"),
    ),
    "parent": Words(("link",)),
    "child": Words(("link",)),
    "axis": Words(("xyz",)),
    "limit": Words(("lower", "upper", "effort", "velocity"), (), ("acceleration", "deceleration", "jerk")),
    "dynamics": Words(("damping", "friction")),
    "mimic": Words(("joint", "multiplier", "offset")),
}
LOOPS = ("constraint", "loop", "loop_joint", "coupling")


def read_words(element: Element) -> tuple[str, ...]:
    """Return notes on what an element says that is not read.

    Raises:
        SceneError: a misspelt or a duplicate word, unexpanded xacro, a loop, a spring.
    """
    words = WORDS[element.tag]
    unknown = ", ".join(_unknown(element, words))
    notes = [element.said(f"{shortened(unknown)}: unknown, not read")] if unknown else []
    seen: dict[str, int] = {}
    for child in element.children:
        if child.tag in words.children:
            if element.tag != "robot" and child.tag in seen:
                raise child.refuse(f"expected one <{child.tag}>, got a second (first in line {seen[child.tag]})")
            seen[child.tag] = child.line
        elif child.tag not in words.skipped:
            _refuse(child, words.children + words.skipped)
            notes.append(child.said("unknown element, not read"))
    if element.stray:
        notes.append(element.said(f"text {quoted(element.stray[0])}, not read"))
    return tuple(notes)


def _unknown(element: Element, words: Words) -> list[str]:
    """Return the attributes that are neither read nor skipped."""
    unknown = []
    for attribute, value in element.attributes.items():
        if attribute in words.attributes or attribute in words.skipped or attribute.split(":")[0] == "xmlns":
            continue
        if near := _misspelt(attribute, words.attributes):
            raise element.refuse(f"{quoted(attribute)}: unknown attribute. Did you mean '{near}'?")
        if attribute == "spring_stiffness" and value.strip("0. ") != "":
            raise element.refuse(f"spring_stiffness: expected none or 0, got {quoted(value)}: joints have no springs")
        unknown.append(attribute)
    return unknown


def _refuse(child: Element, known: tuple[str, ...]) -> None:
    """Refuse an unknown element that is misspelt, unexpanded or closes a loop."""
    if near := _misspelt(child.tag, known):
        raise child.refuse(f"unknown element. Did you mean <{near}>?")
    if child.tag.startswith("xacro:"):
        raise child.refuse("expected plain URDF, got unexpanded xacro; try a file name that ends in .xacro")
    if child.tag in LOOPS:
        raise child.refuse("closes a loop, which joints in series cannot; try deleting it if no arm passes through it")


def _misspelt(word: str, known: tuple[str, ...]) -> str:
    """Return the known word that this one must be a slip of, or nothing."""
    if len(word) > 40:
        return ""
    near = difflib.get_close_matches(word.lower(), known, n=1, cutoff=0.8 if len(word) > 3 else 0.6)
    return near[0] if near else ""
