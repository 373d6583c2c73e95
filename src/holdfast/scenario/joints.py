"""Joints and links that a scene gives itself, and rigid bodies."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from holdfast.io.typed import Location
from holdfast.model.held_object import HeldObject
from holdfast.model.joint import UNBOUNDED, Joint
from holdfast.model.link import Link
from holdfast.scenario.names import require_names
from holdfast.scenario.poses import pose
from holdfast.scenario.scene import BodyData, JointData, ObjectData
from holdfast.spatial.scalar import Array

MASSLESS_INERTIA = np.zeros((3, 3))


def joints_and_links(data: Sequence[JointData], at: Location) -> tuple[list[Joint], list[Link]]:
    """Return joints and the links that they move, base outward.

    Args:
        data: at least one.
        at: their place in the scene.

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
    """Return a rigid body; one without mass needs no inertia.

    Raises:
        SceneError: neither box nor inertia of one with mass, both, or impossible ones.
    """
    with at.refusals():
        if data.mass == 0.0 and data.box is None and data.inertia is None:
            return Link(0.0, np.array(data.com), MASSLESS_INERTIA, data.name)
        return Link(data.mass, np.array(data.com), inertia(data, at), data.name)


def inertia(data: BodyData | ObjectData, at: Location) -> Array:
    """Return the inertia about the mass centre, (3, 3) [kg m^2]: as given, or that of a solid box of uniform density.

    Raises:
        SceneError: neither or both of them, or an edge that is none.
        ModelError: a mass that no box has.
    """
    if (data.box is None) == (data.inertia is None):
        raise at.refuse(f"expected box or inertia, got {'neither' if data.box is None else 'both'}")
    if data.inertia is not None:
        return np.array(data.inertia, dtype=float)
    assert data.box is not None
    for i, edge in enumerate(data.box):
        if edge <= 0:
            raise (at / "box" / i).refuse(f"expected > 0, got {edge:g}")
    return HeldObject.box(data.mass, *data.box).inertia


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
