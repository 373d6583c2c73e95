"""The parts of a scene: poses, grasps and the object, from their data."""

from __future__ import annotations

import math

import numpy as np

from holdfast.io.typed import Location
from holdfast.model import checks
from holdfast.model.grasp import Friction, Grasp, WrenchLimits
from holdfast.model.held_object import HeldObject
from holdfast.scenario.scene import GraspData, ObjectData, PoseData
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose


def pose(data: PoseData | GraspData, at: Location) -> Pose:
    """Return a pose; without an attitude its axes are the reference frame's."""
    if data.quaternion is not None and data.rpy is not None:
        raise at.refuse("expected quaternion or rpy, got both")
    if data.quaternion is None:
        roll, pitch, yaw = data.rpy or (0.0, 0.0, 0.0)
        return Pose(rotation.from_euler_zyx(yaw, pitch, roll), np.array(data.position, dtype=float))
    with (at / "quaternion").refusals():
        return checks.pose(np.array([*data.quaternion, *data.position]), "pose")


def grasp(data: GraspData, at: Location) -> Grasp:
    """Return a grasp."""
    frame = pose(data, at)
    contact = limits = None
    if data.contact is not None:
        with (at / "contact").refusals():
            contact = Friction(data.contact.mu, data.contact.torsion_radius, data.contact.half_length)
    if data.wrench_limits is not None:
        given = data.wrench_limits
        with (at / "wrench_limits").refusals():
            limits = WrenchLimits(*(math.inf if limit is None else limit for limit in (given.moment, given.force)))
    with at.refusals():
        return Grasp(data.kind, frame, contact, limits)


def held_object(data: ObjectData, at: Location) -> HeldObject:
    """Return the object; a box is solid, of uniform density, with its centre at `com`."""
    if (data.box is None) == (data.inertia is None):
        raise at.refuse(f"expected box or inertia, got {'neither' if data.box is None else 'both'}")
    with at.refusals():
        if data.inertia is not None:
            return HeldObject(data.mass, np.array(data.inertia, dtype=float), np.array(data.com, dtype=float))
        assert data.box is not None
        for i, edge in enumerate(data.box):
            if edge <= 0:
                raise (at / "box" / i).refuse(f"expected > 0, got {edge:g}")
        return HeldObject(data.mass, HeldObject.box(data.mass, *data.box).inertia, np.array(data.com, dtype=float))
