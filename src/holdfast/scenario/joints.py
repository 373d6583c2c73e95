"""Poses, names, and the joints, links and rigid bodies that a scene defines itself, without a robot file."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from holdfast.io.files import one_line
from holdfast.io.typed import Location
from holdfast.model import checks
from holdfast.model.held_object import HeldObject
from holdfast.model.joint import Joint
from holdfast.model.link import Link
from holdfast.model.trunk import BASE
from holdfast.model.visuals import VisualShape
from holdfast.scenario.scene import BodyTable, HoldTable, JointTable, ObjectTable
from holdfast.scenario.table import PoseTable
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array

NAME_PATTERN = re.compile(r"\w[\w.-]{0,63}")
MASSLESS_INERTIA = np.zeros((3, 3))
LIMIT_KEYS = ("position_limits", "rate_limit", "effort_limit")
DRIVE_KEYS = ("armature", "damping", "friction", "stiffness", "rest", "pitch", "actuated")
SOLIDS: Mapping[str, Callable[..., HeldObject]] = {
    solid.__name__: solid for solid in (HeldObject.box, HeldObject.sphere, HeldObject.cylinder)
}


def require_names(names: Iterable[str], at: Location, *key: str, optional: bool = False) -> None:
    """Refuse repeated names, and names with characters that would be ambiguous in a path 'arm/joint'.

    Args:
        names: names of the members of a list.
        at: location of the list.
        *key: keys that lead from a member to its name.
        optional: whether a member may have no name, that is, an empty one.

    Raises:
        SceneError: a name that is refused, with the path of the first one.
    """
    first: dict[str, Location] = {}
    for i, name in enumerate(names):
        place = at / i
        for part in key:
            place = place / part
        if optional and not name:
            continue
        if not NAME_PATTERN.fullmatch(name):
            raise place.refuse(f"expected 1 to 64 letters, digits, '_', '-' and '.', got '{one_line(name, 60)}'")
        if name in first:
            raise place.refuse(f"'{name}' is already used at {first[name].path}")
        first[name] = place


def pose(data: PoseTable | HoldTable, at: Location) -> Pose:
    """Return a pose; without an attitude its axes are parallel to the reference frame's."""
    if data.quaternion is not None and data.rpy is not None:
        raise at.refuse("expected quaternion or rpy, got both")
    if data.quaternion is None:
        with at.refusals():
            return Pose.from_rpy(*(data.rpy or (0.0, 0.0, 0.0)), xyz=data.position)
    with (at / "quaternion").refusals():
        return checks.pose(np.array([*data.quaternion, *data.position]), "pose")


def joints_and_links(data: Sequence[JointTable], at: Location) -> tuple[list[Joint], list[Link]]:
    """Return joints and the links that they move, from the base outward.

    Args:
        data: the joints in the scene, at least one.
        at: location of the list in the scene.

    Raises:
        SceneError: with the path of the first fault.
    """
    if not data:
        raise at.refuse("expected at least one joint, got none")
    require_names((one.name for one in data), at, "name", optional=True)
    require_names((one.link.name for one in data), at, "link", "name", optional=True)
    joints = [_joint(one, at / k) for k, one in enumerate(data)]
    return joints, [body(one.link, at / k / "link") for k, one in enumerate(data)]


def parents(data: Sequence[JointTable]) -> list[int | str | None]:
    """Return the link on which each joint stands, as for an `Arm`; nothing for joints in series."""
    if all(one.parent is None for one in data):
        return []
    before = [None, *range(len(data) - 1)]
    given = [k if one.parent is None else one.parent for one, k in zip(data, before, strict=True)]
    return [None if parent == BASE else parent for parent in given]


def body(data: BodyTable, at: Location) -> Link:
    """Return a rigid body; a body without mass needs no inertia.

    Raises:
        SceneError: a body with mass has neither a solid nor an inertia, or it has several of them or an impossible one.
    """
    with at.refusals():
        if data.mass == 0.0 and not _given(data):
            return Link(0.0, np.array(data.com), MASSLESS_INERTIA, data.name)
        return Link(data.mass, np.array(data.com), inertia_and_shape(data, at)[0], data.name)


def inertia_and_shape(data: BodyTable | ObjectTable, at: Location) -> tuple[Array, VisualShape | None]:
    """Return the inertia about the mass centre, (3, 3) [kg m^2], and the shape of a sphere or a cylinder.

    Raises:
        SceneError: there is no solid and no inertia, or more than one of them, or a length is not positive.
        ModelError: the mass is impossible.
    """
    given = _given(data)
    if len(given) != 1:
        expected = "box, sphere, cylinder or inertia"
        raise at.refuse(f"expected {expected}, got {' and '.join(given) if given else 'none of them'}")
    (key,) = given
    value = getattr(data, key)
    if key == "inertia":
        return np.array(value, dtype=float), None
    lengths, places = ((value,), [at / key]) if key == "sphere" else (value, [at / key / i for i in range(len(value))])
    for length, place in zip(lengths, places, strict=True):
        if length <= 0:
            raise place.refuse(f"expected > 0, got {length:g}")
    solid = SOLIDS[key](data.mass, *lengths)
    return solid.inertia, solid.shape


def _given(data: BodyTable | ObjectTable) -> list[str]:
    """Return the keys given for the mass distribution: a solid or an inertia."""
    return [key for key in (*SOLIDS, "inertia") if getattr(data, key) is not None]


def _joint(data: JointTable, at: Location) -> Joint:
    limits = {key: given for key in LIMIT_KEYS if (given := getattr(data, key)) is not None}
    drive = {key: getattr(data, key) for key in DRIVE_KEYS}
    with at.refusals():
        return Joint(data.kind, np.array(data.axis), pose(data, at), data.name, **limits, **drive)
