"""The parts of a scene from their data: poses, grasps, the object, robots, controllers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from holdfast.assembly.starts import preferred_posture
from holdfast.control.controller import Controller
from holdfast.control.gravity_compensation import GravityCompensation
from holdfast.control.object_tracking import ObjectTracking
from holdfast.control.paths import RestToRest
from holdfast.control.torque_schedule import TorqueSchedule
from holdfast.errors import HoldfastError
from holdfast.io.typed import Location
from holdfast.model import checks
from holdfast.model.arm import Arm
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Friction, Grasp, WrenchLimits
from holdfast.model.held_object import HeldObject
from holdfast.model.joint import Joint
from holdfast.model.spring import Spring, SpringEnd
from holdfast.robots import ROBOTS
from holdfast.robots.urdf import UrdfChain, urdf_chain
from holdfast.robots.urdf.source import Source, read_source
from holdfast.scenario.scene import (
    ArmData,
    GraspData,
    GravityCompensationData,
    ObjectData,
    ObjectTrackingData,
    PoseData,
    SpringData,
    TorqueScheduleData,
    UrdfData,
)
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.state import State

GAINS = ("squeeze", "joint_damping", "stiffness", "damping")
MOST_COEFFICIENTS = 20  # of a polynomial; powers of higher order are noise


@dataclass(frozen=True, eq=False)
class Robot:
    """An arm of a scene.

    Attributes:
        arm: the arm, where it stands, with its tool.
        q: (N,) joint positions to start from [rad or m].
        source: the URDF that it is out of; None for a built-in robot.
        links: what became of the file's links; None for a built-in robot.
    """

    arm: Arm
    q: Array
    source: Source | None = None
    links: UrdfChain | None = None


@dataclass(frozen=True)
class RobotFiles:
    """Where a scene's robots come from.

    Attributes:
        folder: that relative names of files start from.
        trust_xacro: whether xacro files may be expanded, which runs the Python in them.
        kept: texts that are taken instead of an arm's file, by the arm's name.
    """

    folder: Path = Path()
    trust_xacro: bool = False
    kept: Mapping[str, Source] = field(default_factory=dict)

    def source(self, data: UrdfData, arm: str) -> Source:
        """Return the URDF of an arm.

        Raises:
            SceneError: the file cannot be read, or is xacro that may not or cannot be expanded.
            MissingExtra: a xacro file without xacrodoc.
        """
        return self.kept.get(arm) or read_source(self.folder / data.file, data.xacro_args, self.trust_xacro)


def pose(data: PoseData | GraspData, at: Location) -> Pose:
    """Return a pose; without an attitude its axes are the reference frame's."""
    if data.quaternion is not None and data.rpy is not None:
        raise at.refuse("expected quaternion or rpy, got both")
    if data.quaternion is None:
        with at.refusals():
            return Pose.from_rpy(*(data.rpy or (0.0, 0.0, 0.0)), xyz=data.position)
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
    motion = None if data.motion is None else np.array(data.motion, dtype=float).T
    with at.refusals():
        return Grasp(data.kind, frame, contact, limits, data.pitch, motion)


def spring(data: SpringData, arms: Mapping[str, Arm], at: Location) -> Spring:
    """Return a spring, its ends' links found."""
    with at.refusals():
        a, b = (SpringEnd(end.body, end.point, end.link) for end in (data.a, data.b))
        return Spring(a, b, data.stiffness, data.length, data.damping).found(arms)


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


def robot(data: ArmData, files: RobotFiles, at: Location) -> Robot:
    """Return an arm where it stands, and the joint positions to start from.

    Args:
        data: the arm's.
        files: where its URDF is, if it has one.
        at: its place in the scene.

    Raises:
        SceneError: no robot of that name, a URDF that cannot be that arm, or positions of the wrong number.
        MissingExtra: a xacro file without xacrodoc.
    """
    if (data.robot is None) == (data.urdf is None):
        raise at.refuse(f"expected robot or urdf, got {'neither' if data.robot is None else 'both'}")
    base = pose(data.base, at / "base")
    tool = None if data.tip is None else pose(data.tip, at / "tip")
    if data.urdf is None:
        found = _built_in(data.robot, base, tool, at)
    else:
        found = _of_file(data.urdf, files, data.name, base, tool, at)
    if data.q is None:
        return found
    q, joints = np.array(data.q, dtype=float), found.arm.joint_count
    if q.shape != (joints,):
        raise (at / "q").refuse(f"expected {joints} joint positions for a {found.arm.name}, got {len(q)}")
    return replace(found, q=q)


def _built_in(name: str | None, base: Pose, tool: Pose | None, at: Location) -> Robot:
    if name is None or name not in ROBOTS:
        raise (at / "robot").refuse(f"no robot '{name}'.{checks.did_you_mean(str(name), ROBOTS)}")
    with at.refusals():
        arm = ROBOTS[name](base=base, tip=tool)
    return Robot(arm, preferred_posture(arm))


def _of_file(data: UrdfData, files: RobotFiles, name: str, base: Pose, tool: Pose | None, at: Location) -> Robot:
    try:
        source = files.source(data, name)
        links = urdf_chain(
            source, base=data.base, tip=data.tip, locked=data.locked, lock_others=data.lock_others, mount=base
        )
    except HoldfastError as cause:  # it names file and line
        raise type(cause)((at / "urdf").message(str(cause))) from cause
    arm = links.arm
    if tool is not None:  # the note is about the link's own frame, not the tool's
        arm = arm.with_tip(arm.tip @ tool)
        links = replace(links, notes=tuple(note for note in links.notes if note != links.tip_note), tip_note="")
    for quantity in ("armature", "stiffness", "rest"):
        if given := getattr(data, quantity):
            arm = replace(arm, joints=_with(quantity, given, arm, at / "urdf" / quantity))
    return Robot(arm, preferred_posture(arm), source, links)


def _with(quantity: str, given: dict[str, float], arm: Arm, at: Location) -> list[Joint]:
    """Return the joints with a quantity, such as their drives' inertia, given by their names."""
    names = [joint.name for joint in arm.joints]
    for name in given:
        if name not in names:
            raise at.refuse(f"no moving joint '{name}'.{checks.did_you_mean(name, names)}")
    joints = []
    for joint in arm.joints:
        with (at / joint.name).refusals():
            joints.append(replace(joint, **{quantity: given.get(joint.name, getattr(joint, quantity))}))
    return joints


def controller(
    data: GravityCompensationData | ObjectTrackingData | TorqueScheduleData,
    chain: ClosedChain,
    state: State,
    at: Location,
) -> Controller:
    """Return the controller; a path begins at the initial state's object pose.

    Raises:
        SceneError: a negative gain, an impossible path or schedule, or no grasp to move the object by.
    """
    if isinstance(data, TorqueScheduleData):
        return _schedule(data, chain, state, at)
    for key in GAINS:
        if getattr(data, key, 0.0) < 0:
            raise (at / key).refuse(f"expected >= 0, got {getattr(data, key):g}")
    if isinstance(data, GravityCompensationData):
        return GravityCompensation(chain, data.squeeze, data.joint_damping)
    if not chain.grasps:
        raise (at / "type").refuse("object_tracking needs a grasp, but no arm has one; try gravity_compensation")
    motion = data.path
    with (at / "path").refusals():
        path = RestToRest(
            state.object_frame, np.array(motion.displacement), np.array(motion.turn), motion.begin, motion.duration
        )
    return ObjectTracking(chain, path.at, data.squeeze, data.stiffness, data.damping, data.joint_damping)


def _schedule(data: TorqueScheduleData, chain: ClosedChain, state: State, at: Location) -> TorqueSchedule:
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
