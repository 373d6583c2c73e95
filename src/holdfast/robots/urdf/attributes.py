"""The elements and attributes of URDF files, read with types; errors give file, line and element.

No name is ignored silently. A name that looks like a misspelling is refused, an element that closes a loop is refused,
and any other unknown name causes a note.
"""

from __future__ import annotations

import difflib
import math
import re
from typing import NamedTuple

import numpy as np

from holdfast.model import checks
from holdfast.robots.urdf.document import Element, quoted, shortened
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array

LARGEST = 1e9  # limit of lengths, angles, masses and inertias in SI units; larger values are mistakes
LONGEST_NAME = 256

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_INFINITE = re.compile(r"[+-]?inf(inity)?", re.ASCII | re.IGNORECASE)


class Vocabulary(NamedTuple):
    """The attributes and children that an element may have.

    Attributes:
        attributes: attributes that are read.
        children: children that are read, each at most once except in <robot>.
        skipped: attributes and children without influence on the dynamics: visuals, contacts, safety
            and extensions of simulators.
    """

    attributes: tuple[str, ...]
    children: tuple[str, ...] = ()
    skipped: tuple[str, ...] = ()


_CHECKED = ("self_filter", "collision_checking", "self_collision_checking")
VOCABULARY = {
    "robot": Vocabulary(
        ("name",),
        ("link", "joint"),
        ("version", "material", "gazebo", "transmission", "ros2_control", "sensor", "mujoco"),
    ),
    "link": Vocabulary(
        ("name",), ("inertial",), ("type", "visual", "collision", "contact", "surface", "concave", "sensor", *_CHECKED)
    ),
    "inertial": Vocabulary((), ("origin", "mass", "inertia")),
    "mass": Vocabulary(("value",)),
    "inertia": Vocabulary(("ixx", "ixy", "ixz", "iyy", "iyz", "izz", "iyx", "izx", "izy")),
    "origin": Vocabulary(("xyz", "rpy")),
    "joint": Vocabulary(
        ("name", "type"),
        ("parent", "child", "origin", "axis", "limit", "dynamics", "mimic"),
        ("calibration", "safety_controller", "hardwareInterface", "dont_collapse"),
    ),
    "parent": Vocabulary(("link",)),
    "child": Vocabulary(("link",)),
    "axis": Vocabulary(("xyz",)),
    "limit": Vocabulary(("lower", "upper", "effort", "velocity"), (), ("acceleration", "deceleration", "jerk")),
    "dynamics": Vocabulary(("damping", "friction", "spring_stiffness", "spring_reference")),
    "mimic": Vocabulary(("joint", "multiplier", "offset")),
}
LOOPS = ("constraint", "loop", "loop_joint", "coupling")


def unread_notes(element: Element) -> tuple[str, ...]:
    """Return notes on everything that is not read in an element and in those of its children that are read.

    Raises:
        SceneError: a name is misspelt or duplicate, the file contains unexpanded xacro, or there is a loop.
    """
    known = VOCABULARY[element.tag]
    unknown = ", ".join(_unknown(element, known))
    notes = [element.message(f"{shortened(unknown)}: unknown, not read")] if unknown else []
    seen: dict[str, int] = {}
    for child in element.children:
        if child.tag in known.children:
            if element.tag != "robot" and child.tag in seen:
                raise child.refuse(f"expected one <{child.tag}>, got a second (first in line {seen[child.tag]})")
            seen[child.tag] = child.line
        elif child.tag not in known.skipped:
            _refuse(child, known.children + known.skipped)
            notes.append(child.message("unknown element, not read"))
    if element.stray:
        notes.append(element.message(f"text {quoted(element.stray[0])}, not read"))
    if element.tag != "robot":
        notes += [note for child in element.children if child.tag in known.children for note in unread_notes(child)]
    return tuple(notes)


def _unknown(element: Element, known: Vocabulary) -> list[str]:
    """Return the attributes that are neither read nor skipped."""
    unknown = []
    for attribute in element.attributes:
        if attribute in known.attributes or attribute in known.skipped or attribute.split(":")[0] == "xmlns":
            continue
        if near := _misspelt(attribute, known.attributes):
            raise element.refuse(f"{quoted(attribute)}: unknown attribute. Did you mean '{near}'?")
        unknown.append(attribute)
    return unknown


def _refuse(child: Element, known: tuple[str, ...]) -> None:
    """Refuse an unknown element that is misspelt, unexpanded or closes a loop."""
    if near := _misspelt(child.tag, known):
        raise child.refuse(f"unknown element. Did you mean <{near}>?")
    if child.tag.startswith("xacro:"):
        raise child.refuse("expected plain URDF, got unexpanded xacro; try a file name that ends in .xacro")
    if child.tag in LOOPS:
        raise child.refuse(
            "closes a loop, which a serial arm cannot contain; try deleting it if no arm passes through it"
        )


def _misspelt(word: str, known: tuple[str, ...]) -> str:
    """Return the known name of which this one seems to be a misspelling, or ''."""
    if len(word) > 40:
        return ""
    near = difflib.get_close_matches(word.lower(), known, n=1, cutoff=0.8 if len(word) > 3 else 0.6)
    return near[0] if near else ""


def name(element: Element, attribute: str = "name") -> str:
    """Return a name, which must be printable, not blank, and at most 256 characters long."""
    stated = text(element, attribute, "a name")
    if not stated.strip() or not stated.isprintable() or len(stated) > LONGEST_NAME:
        raise element.refuse(
            f"{attribute}: expected a name of 1 to {LONGEST_NAME} printable characters, got {len(stated)}:"
            f" {quoted(stated)}"
        )
    return stated


def number(
    element: Element, attribute: str, default: float | None = None, *, at_least: float = -math.inf, size: float = 1e300
) -> float:
    """Return a finite number; if the attribute is missing, the default is returned if there is one."""
    if default is not None and attribute not in element.attributes:
        return default
    (value,) = numbers(element, attribute, 1, size)
    if value < at_least:
        raise element.refuse(f"{attribute}: expected >= {at_least:g}, got {value!r}")
    return value


def limit(element: Element, attribute: str) -> float | None:
    """Return a number, which may be infinite; None if the attribute is missing."""
    stated = element.attributes.get(attribute)
    if stated is None:
        return None
    if len(stated) < 20 and _INFINITE.fullmatch(stated.strip()):
        return float(stated)
    return number(element, attribute)


def vector(element: Element, attribute: str, default: tuple[float, float, float] | None = None) -> Array:
    """Return three numbers; if the attribute is missing, the default is returned if there is one."""
    if default is not None and attribute not in element.attributes:
        return np.array(default)
    return np.array(numbers(element, attribute, 3, LARGEST))


def axis(element: Element) -> Array:
    """Return the unit vector along `xyz`."""
    a = vector(element, "xyz")
    length = math.hypot(*a)
    if length == 0.0:
        raise element.refuse("xyz: expected a direction, got 0 0 0")
    return (a if length == 1.0 else a / length) + 0.0  # no -0.0


def pose(element: Element | None) -> Pose:
    """Return the pose of an <origin> with `xyz`, and `rpy` about the fixed axes x, y, z; the identity for None."""
    if element is None:
        return Pose.identity()
    rpy = vector(element, "rpy", (0.0, 0.0, 0.0))
    return Pose.from_rpy(*rpy, xyz=vector(element, "xyz", (0.0, 0.0, 0.0)) + 0.0)


def text(element: Element, attribute: str, expected: str) -> str:
    """Return the text of an attribute."""
    if attribute not in element.attributes:
        present = [shortened(other) for other in list(element.attributes)[:20]]
        hint = checks.did_you_mean(attribute, present) if present else ""
        raise element.refuse(f"{attribute}: expected {expected}, got no such attribute.{hint}")
    return element.attributes[attribute]


def numbers(element: Element, attribute: str, count: int, size: float) -> list[float]:
    """Return `count` numbers, separated by white space, whose absolute values must not exceed `size`."""
    expected = "a number" if count == 1 else f"{count} numbers separated by blanks"
    stated = text(element, attribute, expected)
    words = stated.split() if len(stated) < 1000 else []
    if len(words) != count or not all(_NUMBER.fullmatch(word) for word in words):
        advice = "; try expanding it with xacro first" if "$" in stated else ""
        raise element.refuse(f"{attribute}: expected {expected}, got {quoted(stated)}{advice}")
    values = [float(word) for word in words]
    if not all(abs(value) <= size for value in values):
        raise element.refuse(f"{attribute}: expected sizes up to {size:g} (SI units), got {quoted(stated)}")
    return values
