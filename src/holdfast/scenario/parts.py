"""Building the parts of a scene from their data: grasps, the object, springs, controllers."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from holdfast.control.controller import Controller
from holdfast.control.gravity_compensation import GravityCompensation
from holdfast.control.object_tracking import ObjectTracking
from holdfast.control.paths import RestToRest
from holdfast.control.pose_spline import HALF_TURN, PoseSpline
from holdfast.control.torque_schedule import TorqueSchedule
from holdfast.io.typed import Location
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.force_element import SpringEnd
from holdfast.model.grasp import Friction, Grasp, WrenchLimits
from holdfast.model.held_object import HeldObject
from holdfast.model.spring import Spring
from holdfast.model.trunk import Trunk
from holdfast.scenario import scene
from holdfast.scenario.joints import inertia_and_shape
from holdfast.scenario.poses import pose
from holdfast.spatial import rotation
from holdfast.state import State

GAINS = ("internal_force", "joint_damping", "stiffness", "damping")
MOST_COEFFICIENTS = 20  # of a polynomial; terms of higher order are lost in rounding


def grasp(data: scene.GraspData, at: Location) -> Grasp:
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
    motion = None if data.motion is None else np.array(data.motion, dtype=float).T
    with at.refusals():
        return Grasp(data.kind, frame, contact, limits, data.pitch, motion, data.stiffness, data.damping)


def spring(data: scene.SpringData, arms: Mapping[str, Arm], trunk: Trunk | None, at: Location) -> Spring:
    """Return a spring whose ends are resolved to links of the arms or the trunk."""
    with at.refusals():
        a, b = (SpringEnd(end.body, end.point, end.link) for end in (data.a, data.b))
        return Spring(a, b, data.stiffness, data.length, data.damping).found(arms, trunk)


def held_object(data: scene.ObjectData, at: Location) -> HeldObject:
    """Return the held object; if a solid is given, it has uniform density and its centre is at `com`."""
    com = np.array(data.com, dtype=float)
    with at.refusals():
        inertia, shape = inertia_and_shape(data, at)
        return HeldObject(data.mass, inertia, com, shape=None if com.any() else shape)  # drawn about C


def controller(
    data: scene.GravityCompensationData | scene.ObjectTrackingData | scene.TorqueScheduleData | None,
    chain: ClosedChain,
    state: State,
    at: Location,
) -> Controller:
    """Return the controller, with zero torques if the scene has none; a path begins at the initial object pose.

    Raises:
        SceneError: a gain is negative, a path or a schedule is impossible, object tracking has no grasp, or the
            controller does not support the chain.
    """
    if data is None:
        return TorqueSchedule([0.0], [np.zeros((chain.joint_count, 1))])
    if isinstance(data, scene.TorqueScheduleData):
        return _schedule(data, chain, state, at)
    for key in GAINS:
        if getattr(data, key, 0.0) < 0:
            raise (at / key).refuse(f"expected >= 0, got {getattr(data, key):g}")
    if isinstance(data, scene.GravityCompensationData):
        with at.refusals():
            return GravityCompensation(chain, data.internal_force, data.joint_damping)
    if not chain.grasps:
        raise (at / "type").refuse("object_tracking needs a grasp, but no arm has one; try gravity_compensation")
    path = object_path(data.path, state, at / "path")
    with at.refusals():
        return ObjectTracking(chain, path.at, data.internal_force, data.stiffness, data.damping, data.joint_damping)


def object_path(data: scene.PathData, state: State, at: Location) -> RestToRest | PoseSpline:
    """Return the path of the object, which begins at its initial pose.

    Raises:
        SceneError: keys that exclude each other are given, or the path is impossible.
    """
    if data.through is None:
        if data.duration is None:
            raise (at / "duration").refuse("expected a duration, or poses to go through, got neither")
        with at.refusals():
            return RestToRest(
                state.object_frame, np.array(data.displacement), np.array(data.turn), data.begin, data.duration
            )
    for key, given in (
        ("duration", data.duration is not None),
        ("displacement", any(data.displacement)),
        ("turn", any(data.turn)),
    ):
        if given:
            raise (at / key).refuse("expected none, as the path goes through poses, which say where and when")
    if not data.through:
        raise (at / "through").refuse("expected one pose or more, got none")
    poses = [state.object_frame, *(pose(via, at / "through" / k) for k, via in enumerate(data.through))]
    for k, via in enumerate(data.through):
        before = data.through[k - 1].t if k else data.begin
        if via.t <= before:
            what = "the pose before it" if k else "the begin"
            raise (at / "through" / k / "t").refuse(f"expected a time after {what} at {before:g} s, got {via.t:g}")
        if np.linalg.norm(rotation.log(poses[k].R.T @ poses[k + 1].R)) > HALF_TURN:
            raise (at / "through" / k).refuse(
                "expected less than half a turn from where it was before; try a pose between"
            )
    with (at / "through").refusals():
        return PoseSpline(poses, [data.begin, *(via.t for via in data.through)])


def _schedule(data: scene.TorqueScheduleData, chain: ClosedChain, state: State, at: Location) -> TorqueSchedule:
    names, tables = chain.joint_names(), []
    for i, piece in enumerate(data.pieces):
        here = at / "pieces" / i / "torques"
        if len(piece.torques) != len(names):
            listed = f"{names[0]} .. {names[-1]}"
            raise here.refuse(f"expected one list for each of {len(names)} joints ({listed}), got {len(piece.torques)}")
        for k, row in enumerate(piece.torques):
            if not row:
                raise (here / k).refuse("expected at least one coefficient, got none")
            if len(row) > MOST_COEFFICIENTS:
                raise (here / k).refuse(f"expected at most {MOST_COEFFICIENTS} coefficients, got {len(row)}")
        width = max(map(len, piece.torques))
        tables.append(np.array([row + [0.0] * (width - len(row)) for row in piece.torques]))
    beside = None if data.beside is None else controller(data.beside, chain, state, at / "beside")
    with (at / "pieces").refusals():
        return TorqueSchedule(np.array([piece.begin for piece in data.pieces]), tables, beside)
