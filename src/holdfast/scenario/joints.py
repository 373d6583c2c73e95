"""Joints, links and rigid bodies that are defined in the scene itself rather than in a robot file."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from holdfast.io.typed import Location
from holdfast.model.held_object import HeldObject
from holdfast.model.joint import UNBOUNDED, Joint
from holdfast.model.link import Link
from holdfast.model.visuals import Shape
from holdfast.scenario.names import require_names
from holdfast.scenario.poses import pose
from holdfast.scenario.scene import BodyData, JointData, ObjectData
from holdfast.spatial.scalar import Array

MASSLESS_INERTIA = np.zeros((3, 3))


def joints_and_links(data: Sequence[JointData], at: Location) -> tuple[list[Joint], list[Link]]:
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


def body(data: BodyData, at: Location) -> Link:
    """Return a rigid body; a body without mass needs no inertia.

    Raises:
        SceneError: a body with mass has neither a solid nor an inertia, or it has several of them or an impossible one.
    """
    with at.refusals():
        if data.mass == 0.0 and not _given(data):
            return Link(0.0, np.array(data.com), MASSLESS_INERTIA, data.name)
        return Link(data.mass, np.array(data.com), inertia_and_shape(data, at)[0], data.name)


def inertia_and_shape(data: BodyData | ObjectData, at: Location) -> tuple[Array, Shape | None]:
    """Return the inertia about the mass centre, (3, 3) [kg m^2], and the shape of a sphere or a cylinder.

    Raises:
        SceneError: there is no solid and no inertia, or more than one of them, or a length is not positive.
        ModelError: the mass is impossible.
    """
    given = _given(data)
    if len(given) != 1:
        expected = "box, sphere, cylinder or inertia"
        raise at.refuse(f"expected {expected}, got {' and '.join(given) if given else 'none of them'}")
    for key in ("box", "cylinder"):
        for i, length in enumerate(getattr(data, key) or ()):
            if length <= 0:
                raise (at / key / i).refuse(f"expected > 0, got {length:g}")
    if data.sphere is not None and data.sphere <= 0:
        raise (at / "sphere").refuse(f"expected > 0, got {data.sphere:g}")
    if data.box is not None:
        return HeldObject.box(data.mass, *data.box).inertia, None
    if data.inertia is not None:
        return np.array(data.inertia, dtype=float), None
    if data.sphere is not None:
        solid = HeldObject.sphere(data.mass, data.sphere)
    else:
        assert data.cylinder is not None
        solid = HeldObject.cylinder(data.mass, *data.cylinder)
    return solid.inertia, solid.shape


def _given(data: BodyData | ObjectData) -> list[str]:
    """Return the keys given for the mass distribution: a solid or an inertia."""
    return [key for key in ("box", "sphere", "cylinder", "inertia") if getattr(data, key) is not None]


def _joint(data: JointData, at: Location) -> Joint:
    with at.refusals():
        return Joint(
            data.kind,
            np.array(data.axis),
            pose(data, at),
            data.name,
            UNBOUNDED if data.position_limits is None else data.position_limits,
            math.inf if data.rate_limit is None else data.rate_limit,
            math.inf if data.effort_limit is None else data.effort_limit,
            data.armature,
            data.damping,
            data.friction,
            data.stiffness,
            data.rest,
        )
