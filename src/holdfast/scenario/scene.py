"""The format of scenes: strict structures of a TOML file. SI units, world axes, +z up."""

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
    """Base of the file's structures."""


class PoseData(_Strict):
    """A pose: position and, as quaternion (w, x, y, z) or as roll, pitch, yaw, an attitude."""

    position: Vector3 = ZEROS
    quaternion: Quaternion | None = None
    rpy: Vector3 | None = None


class SwayData(_Strict):
    """Three sine oscillations: a sin(2 pi f t + phase) along or about each world axis."""

    amplitude: Vector3
    frequency: Vector3
    phase: Vector3 = ZEROS


class BaseMotionData(_Strict):
    """A base that sways about where it stands; it sets out smoothly, within `smooth_start` seconds.

    `shift` in m, `turn` in rad: roll, pitch, yaw about the base's origin.
    """

    shift: SwayData | None = None
    turn: SwayData | None = None
    smooth_start: float = 0.5


class BodyData(_Strict):
    """A rigid body: mass, and a solid of uniform density about `com` or an inertia about it, in the body's axes.

    The solid is a box of three edges, a sphere of a radius, or a cylinder about z of a radius and a length.
    """

    mass: float
    box: Vector3 | None = None
    sphere: float | None = None
    cylinder: tuple[float, float] | None = None
    inertia: Matrix3 | None = None
    com: Vector3 = ZEROS
    name: str = ""


class JointData(PoseData, kw_only=True):
    """A joint and the link that it moves; the pose is of that link's frame at q = 0, in the axes of the link before."""

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
    """An arm out of a URDF or xacro file, see `load_urdf`; `file` starts from the scene's folder.

    `armature`: inertia of drives felt at their joints [kg m^2 or kg], which URDF has no place for. `stiffness` [N m/rad
    or N/m] and `rest` [rad or m]: of springs in joints.
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
    """A trunk out of such a file: the joints from `base` to `tip`, or those that arms with `tips` in the file share.

    `tips` has the link of each arm's tip by the arm's name; see `load_urdf_trunk`. With `floating` the base is a free
    body with all that is fixed to it.
    """

    tips: dict[str, str] = {}
    floating: bool = False


class ArmData(_Strict):
    """An arm: a built-in robot's name, a URDF, joints, or an anchor; where it stands, its tool, where its joints begin.

    An arm with a `mount` stands on that link of the trunk, its `base` in the link's axes. One that the trunk's
    file has a tip of is out of that file. `tip` is the pose of a massless tool's tip in the robot's own tip frame,
    or in the axes of the last link of `joints`. `q` is a guess from which the arm is moved to its grasp. Without it
    that is the robot's home configuration, or the middle of its joints' ranges, and others are tried where it does not
    lead to the grasp. An `anchor` has no joints; without a `base` it stands where its grasp is at the start.
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
    """What arms stand on: a built-in robot's name, a URDF, or joints; perhaps on a body that floats.

    `base` is where its base frame is, of a floating base at the start, with a `twist` then. Its joints begin, and the
    arms are led to the object, at `q`: the robot's home configuration, or the middle of the joints' ranges, by default.
    """

    robot: str | None = None
    urdf: TrunkUrdfData | None = None
    joints: list[JointData] | None = None
    floating: BodyData | None = None
    base: PoseData = msgspec.field(default_factory=PoseData)
    twist: Twist | None = None
    q: list[float] | None = None
    base_motion: BaseMotionData | None = None


class ObjectData(_Strict):
    """The held object: mass, and a solid or an inertia about the mass centre; how it moves at first.

    The solid is as in `BodyData`; `twist` is [omega; v of its origin], world axes, at the start.
    """

    mass: float
    box: Vector3 | None = None
    sphere: float | None = None
    cylinder: tuple[float, float] | None = None
    inertia: Matrix3 | None = None
    com: Vector3 = ZEROS
    pose: PoseData = msgspec.field(default_factory=PoseData)
    twist: Twist = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class ContactData(_Strict):
    """Friction of a one-sided contact."""

    mu: float
    torsion_radius: float | None = None
    half_length: float | None = None


class WrenchLimitsData(_Strict):
    """The largest moment [N m] and force [N] that a grasp takes."""

    moment: float | None = None
    force: float | None = None


class GraspData(_Strict):
    """A grasp: the contact frame in object axes, z into the object."""

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
    """An arm grips at time `t`: at the frame given, or, with `here`, where its tip is then."""

    t: float
    here: bool = False


class ReleaseData(_Strict, tag_field="type", tag="release"):
    """An arm lets go at time `t`."""

    t: float
    arm: str


class SpringEndData(_Strict):
    """An end of a spring: on "world", "object", or a link of an arm or of "trunk", in their axes [m]."""

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
    """A pose in the world that the object passes at time `t`."""

    t: float


class PathData(_Strict):
    """A smooth motion of the object from rest to rest, world axes: a displacement and a turn, or `through` poses."""

    duration: float | None = None
    displacement: Vector3 = ZEROS
    turn: Vector3 = ZEROS
    through: list[ViaData] | None = None
    begin: float = 0.0


class GravityCompensationData(_Strict, tag_field="type", tag="gravity_compensation"):
    """Hold the chain still against gravity."""

    squeeze: float = 0.0
    joint_damping: float = 0.0


class ObjectTrackingData(_Strict, tag_field="type", tag="object_tracking"):
    """Move the object along a path by computed torque."""

    path: PathData
    squeeze: float = 0.0
    stiffness: float = 100.0
    damping: float = 20.0
    joint_damping: float = 10.0


class PieceData(_Strict):
    """Torques from `begin` to the next piece: per joint [c0, c1, ...] of c0 + c1 (t - begin) + ..."""

    begin: float
    torques: list[list[float]]


class TorqueScheduleData(_Strict, tag_field="type", tag="torque_schedule"):
    """Torques as given functions of time, added to those of another controller, if there is one beside."""

    pieces: list[PieceData]
    beside: GravityCompensationData | ObjectTrackingData | None = None


class SimulationData(_Strict):
    """How long, in which steps, and what is done about slipping grasps and passed limits.

    At `breakpoints` steps end; knots of a schedule, events and ends of wrenches are such times anyway. `rtol` and
    `atol` are for an adaptive scheme, `largest_drift` for the others: see `simulate`. With a `sample_time` the
    controller is asked once a sample, and `delay` after that its torques act.
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
    """Every number drawn uniformly between two bounds."""

    low: Numbers
    high: Numbers


class NormalData(_Strict, tag_field="type", tag="normal"):
    """Every number drawn normally."""

    mean: Numbers
    deviation: Numbers


class NearPoseData(_Strict, tag_field="type", tag="near_pose"):
    """Poses near those that the scene has, turned and shifted in their own axes by up to so much per coordinate."""

    turn: float = 0.0
    shift: float = 0.0


class SweepData(_Strict):
    """Many runs of the scene by `holdfast sweep`: how many, what differs from run to run, what is kept of each."""

    count: int
    parameters: dict[str, UniformData | NormalData | NearPoseData | Numbers | Literal["scale"]]
    seed: int = 0
    chunk: int = 1000
    outputs: list[str] | None = None


class SceneData(_Strict):
    """A scene: arms, what they stand on, the object they hold, a controller, and how long to simulate."""

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
    gravity: Vector3 = STANDARD_GRAVITY
    name: str = ""
