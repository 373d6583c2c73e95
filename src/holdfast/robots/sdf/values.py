"""The numbers in elements of SDF files, which are texts of elements; errors give file, line and element."""

from __future__ import annotations

import math

import numpy as np

from holdfast.robots.urdf.attributes import LARGEST_VALUE, parsed
from holdfast.robots.urdf.document import Element, quoted
from holdfast.robots.urdf.vocabulary import text_of
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array

INFINITE_LIMIT = 1e16  # SDF's limits beyond it are none
SWITCH = {"true": True, "1": True, "false": False, "0": False}


def child_number(
    element: Element | None, tag: str, default: float | None = None, *, at_least: float = -math.inf
) -> float:
    """Return the number in a child; if it is missing, the default is returned if there is one."""
    child = None if element is None else element.first(tag)
    if child is None and default is not None:
        return default
    assert element is not None
    child = element.required(tag)
    (value,) = parsed(child, tag, text_of(child))
    if value < at_least:
        raise child.refuse(f"expected >= {at_least:g}, got {value!r}")
    return value


def child_limit(element: Element | None, tag: str, default: float) -> float:
    """Return the limit in a child, infinite beyond 1e16; the default if it is missing."""
    child = None if element is None else element.first(tag)
    if child is None:
        return default
    stated = text_of(child)
    if stated.lower().lstrip("+-") in ("inf", "infinity"):
        return -math.inf if stated.startswith("-") else math.inf
    (value,) = parsed(child, tag, stated, size=1e300)
    return value if abs(value) < INFINITE_LIMIT else math.copysign(math.inf, value)


def switch(element: Element | None, default: bool) -> bool:
    """Return whether an element says true."""
    if element is None:
        return default
    if (word := text_of(element).lower()) not in SWITCH:
        raise element.refuse(f"expected true or false, got {quoted(text_of(element))}")
    return SWITCH[word]


def unit_vector(element: Element) -> Array:
    """Return the unit vector in an element."""
    a = np.array(parsed(element, element.tag, text_of(element), 3))
    length = math.hypot(*a)
    if length == 0.0:
        raise element.refuse("expected a direction, got 0 0 0")
    return (a if length == 1.0 else a / length) + 0.0  # no -0.0


def pose_in(element: Element | None) -> Pose:
    """Return the pose in a <pose>, x y z and roll pitch yaw about fixed axes or a quaternion x y z w."""
    if element is None or not text_of(element):
        return Pose.identity()
    kind = element.attributes.get("rotation_format", "euler_rpy")
    if kind not in ("euler_rpy", "quat_xyzw"):
        raise element.refuse(f"rotation_format: expected euler_rpy or quat_xyzw, got {quoted(kind)}")
    count = 6 if kind == "euler_rpy" else 7
    xyz, turn = np.split(np.array(parsed(element, "pose", text_of(element), count, LARGEST_VALUE)), [3])
    if kind == "euler_rpy":
        degrees = element.attributes.get("degrees", "false").lower()
        if degrees not in SWITCH:
            raise element.refuse(f"degrees: expected true or false, got {quoted(degrees)}")
        return Pose.from_rpy(*(np.radians(turn) if SWITCH[degrees] else turn), xyz=xyz + 0.0)
    length = float(np.linalg.norm(turn))
    if not abs(length - 1.0) < 1e-3:
        raise element.refuse(f"expected a unit quaternion x y z w, got one of length {length:.6g}")
    x, y, z, w = turn / length
    return Pose.from_wxyz_xyz([w, x, y, z, *xyz])
