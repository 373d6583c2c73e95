"""The attributes of URDF files, read with types; errors give file, line and element."""

from __future__ import annotations

import math
import re

import numpy as np

from holdfast.model import checks
from holdfast.robots.urdf.document import Element, quoted, shortened
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array

LARGEST_VALUE = 1e9  # limit of lengths, angles, masses and inertias in SI units; larger values are mistakes
LONGEST_URDF_NAME = 256

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_INFINITE = re.compile(r"[+-]?inf(inity)?", re.ASCII | re.IGNORECASE)


def name(element: Element, attribute: str = "name") -> str:
    """Return a name, which must be printable, not blank, and at most 256 characters long."""
    stated = text(element, attribute, "a name")
    if not stated.strip() or not stated.isprintable() or len(stated) > LONGEST_URDF_NAME:
        raise element.refuse(
            f"{attribute}: expected a name of 1 to {LONGEST_URDF_NAME} printable characters, got {len(stated)}:"
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
    return np.array(numbers(element, attribute, 3, LARGEST_VALUE))


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
    return parsed(element, attribute, text(element, attribute, expected), count, size)


def parsed(element: Element, what: str, stated: str, count: int = 1, size: float = LARGEST_VALUE) -> list[float]:
    """Return the `count` numbers in a text, whose absolute values must not exceed `size`."""
    expected = "a number" if count == 1 else f"{count} numbers separated by blanks"
    words = stated.split() if len(stated) < 1000 else []
    if len(words) != count or not all(_NUMBER.fullmatch(word) for word in words):
        advice = "; try expanding it with xacro first" if "$" in stated else ""
        raise element.refuse(f"{what}: expected {expected}, got {quoted(stated)}{advice}")
    values = [float(word) for word in words]
    if not all(abs(value) <= size for value in values):
        raise element.refuse(f"{what}: expected sizes up to {size:g} (SI units), got {quoted(stated)}")
    return values
