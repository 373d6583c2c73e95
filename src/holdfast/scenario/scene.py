"""The format of scene files: the tables and keys of the TOML file. SI units, world axes, +z up."""

from __future__ import annotations

from typing import Literal

import msgspec

from holdfast.model.closed_chain import STANDARD_GRAVITY
from holdfast.model.grasp import GraspName
from holdfast.simulation.adaptive import RTOL
from holdfast.simulation.margins import OnLimit, OnSingular, OnSlip

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Twist = tuple[float, float, float, float, float, float]
Matrix3 = tuple[Vector3, Vector3, Vector3]
ZEROS: Vector3 = (0.0, 0.0, 0.0)


class _Strict(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """Base of all tables; unknown keys are errors."""


class PoseData(_Strict):
    """A pose: a position, and an attitude as a quaternion (w, x, y, z) or as roll, pitch, yaw."""

    position: Vector3 = ZEROS
    quaternion: Quaternion | None = None
    rpy: Vector3 | None = None


class SwayData(_Strict):
    """Three sine oscillations: a sin(2 pi f t + phase) along or about each world axis."""

    amplitude: Vector3
    frequency: Vector3
    phase: Vector3 = ZEROS


class BaseMotionData(_Strict):
    """A base that oscillates about its pose; the amplitude grows smoothly from zero within `smooth_start` seconds.

    `shift` is in m; `turn` is in rad: roll, pitch, yaw about the base's origin.
    """

    shift: SwayData | None = None
    turn: SwayData | None = None
    smooth_start: float = 0.5


class _Solid(_Strict):
    """A mass, and a solid of uniform density centred at `com` or the inertia about `com`."""

    mass: float
    box: Vector3 | None = None
    sphere: float | None = None
    cylinder: tuple[float, float] | None = None
    inertia: Matrix3 | None = None
    com: Vector3 = ZEROS


class BodyData(_Solid, kw_only=True):
    """A rigid body: its mass and either a solid of uniform density centred at `com`, or the inertia about `com`.

    All are in the body's axes. The solid is a box with three edges, a sphere with a radius, or a cylinder about z with
    a radius and a length.
    """

    name: str = ""


class JointData(PoseData, kw_only=True):
    """A joint and the link that it moves; the pose is of the link's frame at q = 0, in the previous link's frame."""

    link: BodyData
    name: str = ""
    kind: Literal["revolute", "prismatic"] = "revolute"
    axis: Vector3 = (0.0, 0.0, 1.0)
    position_limits: tuple[float, float] | None = None
    rate_limit: float | None = None
    effort_limit: float | None = None
    armature: float = 0.0
    damping: float = 0.0
    friction: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0


class UrdfData(_Strict):
    """An arm from a URDF or xacro file, see `load_urdf`; `file` is relative to the scene's folder.

    `armature` is the inertia of the drives reflected to their joints [kg m^2 or kg], which URDF cannot express.
    `stiffness` [N m/rad or N/m] and `rest` [rad or m] define springs in the joints.
    """

    file: str
    base: str | None = None
    tip: str | None = None
    locked: dict[str, float] = {}
    lock_others: bool = False
    xacro_args: dict[str, str] = {}
    armature: dict[str, float] = {}
    stiffness: dict[str, float] = {}
    rest: dict[str, float] = {}


class TrunkUrdfData(UrdfData, kw_only=True):
    """A trunk from a URDF or xacro file: the joints from `base` to `tip`, or the joints shared by the arms in `tips`.

    `tips` maps the name of an arm to the link of its tip, see `load_urdf_trunk`. With `floating`, the base link and all
    links fixed to it are a free-floating body.
    """

    tips: dict[str, str] = {}
    floating: bool = False


class ArmData(_Strict):
    """An arm: a built-in robot, a URDF, joints, or an anchor, with its base, its tool and its joint positions.

    An arm with a `mount` is mounted on that link of the trunk, and its `base` is in the link's frame. An arm that is
    listed in the `tips` of the trunk's file is loaded from that file. `tip` is the pose of a massless tool's tip in the
    robot's own tip frame, or in the frame of the last of the `joints`. `q` is an initial guess from which the arm is
    moved to its grasp. By default it is the robot's home configuration, or the middle of the joint ranges, and other
    guesses are tried if the arm does not reach its grasp from there. An `anchor` has no joints; by default its `base`
    is the initial pose of its grasp.
    """

    name: str
    robot: str | None = None
    urdf: UrdfData | None = None
    joints: list[JointData] | None = None
    anchor: bool = False
    mount: str | int | None = None
    base: PoseData | None = None
    tip: PoseData | None = None
    q: list[float] | None = None
    base_motion: BaseMotionData | None = None


class TrunkData(_Strict):
    """The trunk on which arms are mounted: a built-in robot's name, a URDF, or joints, possibly on a floating body.

    `base` is the pose of its base frame. For a floating base this is the initial pose, and `twist` its initial twist.
    `q` has the initial positions of its joints, which are not changed when the arms are moved to their grasps; by
    default the robot's home configuration, or the middle of the joint ranges.
    """

    robot: str | None = None
    urdf: TrunkUrdfData | None = None
    joints: list[JointData] | None = None
    floating: BodyData | None = None
    base: PoseData = msgspec.field(default_factory=PoseData)
    twist: Twist | None = None
    q: list[float] | None = None
    base_motion: BaseMotionData | None = None


class ObjectData(_Solid, kw_only=True):
    """The held object: its mass, a solid or an inertia about the mass centre, and its initial pose and twist.

    The solid is as in `BodyData`; `twist` is the initial [omega; v of its origin], world axes.
    """

    pose: PoseData = msgspec.field(default_factory=PoseData)
    twist: Twist = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class ContactData(_Strict):
    """Friction of a unilateral contact."""

    mu: float
    torsion_radius: float | None = None
    half_length: float | None = None


class WrenchLimitsData(_Strict):
    """The largest moment [N m] and force [N] that a grasp can transmit."""

    moment: float | None = None
    force: float | None = None


class GraspData(_Strict):
    """A grasp: its kind, and its contact frame in the object's frame, with z pointing into the object."""

    arm: str
    kind: GraspName
    position: Vector3 = ZEROS
    quaternion: Quaternion | None = None
    rpy: Vector3 | None = None
    pitch: float | None = None
    motion: list[Twist] | None = None
    stiffness: list[float | list[float]] | None = None
    damping: list[float | list[float]] | None = None
    contact: ContactData | None = None
    wrench_limits: WrenchLimitsData | None = None


class AttachData(GraspData, kw_only=True, tag_field="type", tag="attach"):
    """An arm grasps the object at time `t`, at the given frame or, with `here`, where its tip is at that time."""

    t: float
    here: bool = False


class ReleaseData(_Strict, tag_field="type", tag="release"):
    """An arm releases the object at time `t`."""

    t: float
    arm: str


class SpringEndData(_Strict):
    """An end of a spring: a point of "world", "object", or a link of an arm or of "trunk", in its frame [m]."""

    body: str
    point: Vector3 = ZEROS
    link: str | int | None = None


class SpringData(_Strict):
    """A spring and damper between two points [N/m, m, N s/m]."""

    a: SpringEndData
    b: SpringEndData
    stiffness: float
    length: float = 0.0
    damping: float = 0.0


class WrenchData(_Strict):
    """An external wrench on the object about its origin, world axes, from `begin` to `end`."""

    force: Vector3 = ZEROS
    moment: Vector3 = ZEROS
    begin: float = 0.0
    end: float | None = None


class ViaData(PoseData, kw_only=True):
    """A world pose through which the object passes at time `t`."""

    t: float


class PathData(_Strict):
    """A smooth rest-to-rest motion of the object: a displacement and a rotation, or `through` poses; world axes."""

    duration: float | None = None
    displacement: Vector3 = ZEROS
    turn: Vector3 = ZEROS
    through: list[ViaData] | None = None
    begin: float = 0.0


class GravityCompensationData(_Strict, tag_field="type", tag="gravity_compensation"):
    """Balance gravity."""

    internal_force: float = 0.0
    joint_damping: float = 0.0


class ObjectTrackingData(_Strict, tag_field="type", tag="object_tracking"):
    """Move the object along a path by computed torque."""

    path: PathData
    internal_force: float = 0.0
    stiffness: float = 100.0
    damping: float = 20.0
    joint_damping: float = 10.0


class PieceData(_Strict):
    """Torques from `begin` to the next piece: polynomials c0 + c1 (t - begin) + ..., [c0, c1, ...] for each joint."""

    begin: float
    torques: list[list[float]]


class TorqueScheduleData(_Strict, tag_field="type", tag="torque_schedule"):
    """Torques as given functions of time; they are added to those of the controller `beside`, if there is one."""

    pieces: list[PieceData]
    beside: GravityCompensationData | ObjectTrackingData | None = None


class SimulationData(_Strict):
    """Duration, step and scheme of the simulation, and the policies for slipping grasps and exceeded limits.

    Steps end at `breakpoints`, and in any case at the knots of a schedule, at events, and where wrenches begin or end.
    `rtol` and `atol` are for an adaptive scheme and `largest_drift` for the others, see `simulate`. With a
    `sample_time` the controller is evaluated once per sample, and its torques act from `delay` after the sample.
    """

    duration: float
    step: float
    scheme: Literal["rk4", "midpoint", "dop853", "imex"] = "rk4"
    rtol: float = RTOL
    atol: float | None = None
    largest_drift: float | None = None
    sample_time: float | None = None
    delay: float = 0.0
    on_slip: OnSlip = "stop"
    on_limit: OnLimit = "record"
    on_singular: OnSingular = "stop"
    breakpoints: list[float] = []


Numbers = float | list[float | list[float]]


class UniformData(_Strict, tag_field="type", tag="uniform"):
    """Every number is drawn uniformly between two bounds."""

    low: Numbers
    high: Numbers


class NormalData(_Strict, tag_field="type", tag="normal"):
    """Every number is drawn from a normal distribution."""

    mean: Numbers
    deviation: Numbers


class NearPoseData(_Strict, tag_field="type", tag="near_pose"):
    """Poses near those in the scene, rotated and shifted by up to `turn` and `shift` along each of their own axes."""

    turn: float = 0.0
    shift: float = 0.0


class SweepData(_Strict):
    """Many runs of the scene by `holdfast sweep`: their number, the varied parameters, and the recorded outputs."""

    count: int
    parameters: dict[str, UniformData | NormalData | NearPoseData | Numbers | Literal["scale"]]
    seed: int = 0
    chunk: int = 1000
    outputs: list[str] | None = None


class SceneData(_Strict):
    """A scene: the arms, their trunk if any, the held object, grasps, a controller, and the simulation settings.

    `packages` are the folders of packages by name to which robot files refer, relative to the scene's folder.
    """

    arms: list[ArmData]
    object: ObjectData
    simulation: SimulationData
    controller: GravityCompensationData | ObjectTrackingData | TorqueScheduleData | None = None
    trunk: TrunkData | None = None
    grasps: list[GraspData] = []
    events: list[AttachData | ReleaseData] = []
    wrenches: list[WrenchData] = []
    springs: list[SpringData] = []
    sweep: SweepData | None = None
    packages: dict[str, str] = {}
    gravity: Vector3 = STANDARD_GRAVITY
    name: str = ""
