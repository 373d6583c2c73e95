"""The format of scene files: the tables and keys of the TOML file. SI units, world axes, +z up."""

from __future__ import annotations

from typing import Literal

import msgspec

from holdfast.io.recording_table import RecordingTable
from holdfast.model.closed_chain import STANDARD_GRAVITY
from holdfast.model.grasp import GraspName
from holdfast.model.joint import ArmJointName
from holdfast.scenario.controller_tables import ControllerTable
from holdfast.scenario.table import ZEROS, BaseMotionTable, KeyTable, NumberRows, PoseTable, Quaternion, Triple, Twist
from holdfast.scenario.world_tables import TouchingTable, WorldTable
from holdfast.simulation.adaptive import RTOL
from holdfast.simulation.margins import OnLimit, OnSingular, OnSlip
from holdfast.simulation.run_record import EVERYTHING


class _Solid(KeyTable):
    """A mass, and a solid of uniform density centred at `com` or the inertia about `com`."""

    mass: float
    box: Triple | None = None
    sphere: float | None = None
    cylinder: tuple[float, float] | None = None
    inertia: tuple[Triple, Triple, Triple] | None = None
    com: Triple = ZEROS


class BodyTable(_Solid, kw_only=True):
    """A rigid body: its mass and either a solid of uniform density centred at `com`, or the inertia about `com`.

    All are in the body's axes. The solid is a box with three edges, a sphere with a radius, or a cylinder about z with
    a radius and a length.
    """

    name: str = ""


class JointTable(PoseTable, kw_only=True):
    """A joint and the link that it moves; the pose is of the link's frame at q = 0, in the frame of the parent link.

    The `parent` is the link of an earlier joint, by its name or index, or "base"; by default the previous link.
    """

    link: BodyTable
    name: str = ""
    kind: ArmJointName = "revolute"
    axis: Triple = (0.0, 0.0, 1.0)
    pitch: float | None = None
    parent: str | int | None = None
    actuated: bool = True
    position_limits: tuple[float, float] | None = None
    rate_limit: float | None = None
    effort_limit: float | None = None
    armature: float = 0.0
    damping: float = 0.0
    friction: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0


class UrdfTable(KeyTable):
    """An arm from a URDF, SDF or xacro file, see `load_urdf`; `file` is relative to the scene's folder.

    `armature` is the inertia of the drives reflected to their joints [kg m^2 or kg], which URDF cannot express.
    `stiffness` [N m/rad or N/m] and `rest` [rad or m] define springs in the joints. With `branches`, other joints on
    the arm move, too, and `loop_closures` are pairs of links between which loops close, perhaps with a grasp kind.
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
    branches: bool = False
    loop_closures: list[list[str]] = []


class TrunkUrdfTable(UrdfTable, kw_only=True):
    """A trunk from a URDF, SDF or xacro file: the joints from `base` to `tip`, or those shared by the arms in `tips`.

    `tips` maps the name of an arm to the link of its tip, see `load_urdf_trunk`. With `floating`, the base link and all
    links fixed to it are a free-floating body.
    """

    tips: dict[str, str] = {}
    floating: bool = False


class FrameTable(PoseTable, kw_only=True):
    """A further frame on a link of an arm, for example of a finger's pad."""

    link: str | int


class ArmTable(KeyTable):
    """An arm: a built-in robot, a URDF, joints, or an anchor, with its base, its tool and its joint positions.

    An arm with a `mount` is mounted on that link of the trunk, and its `base` is in the link's frame. An arm that is
    listed in the `tips` of the trunk's file is loaded from that file. `tip` is the pose of a massless tool's tip in the
    robot's own tip frame, or in the frame of the last of the `joints`. `q` is an initial guess from which the arm is
    moved to its grasp. By default it is the robot's home configuration, or the middle of the joint ranges, and other
    guesses are tried if the arm does not reach its grasp from there. An `anchor` has no joints; by default its `base`
    is the initial pose of its grasp. `frames` are further frames by which it can hold something.
    """

    name: str
    robot: str | None = None
    urdf: UrdfTable | None = None
    joints: list[JointTable] | None = None
    anchor: bool = False
    mount: str | int | None = None
    base: PoseTable | None = None
    tip: PoseTable | None = None
    q: list[float] | None = None
    frames: dict[str, FrameTable] = {}
    base_motion: BaseMotionTable | None = None


class TrunkTable(KeyTable):
    """The trunk on which arms are mounted: a built-in robot's name, a URDF, or joints, possibly on a floating body.

    `base` is the pose of its base frame. For a floating base this is the initial pose, and `twist` its initial twist.
    `q` has the initial positions of its joints, which are not changed when the arms are moved to their grasps; by
    default the robot's home configuration, or the middle of the joint ranges.
    """

    robot: str | None = None
    urdf: TrunkUrdfTable | None = None
    joints: list[JointTable] | None = None
    floating: BodyTable | None = None
    base: PoseTable = msgspec.field(default_factory=PoseTable)
    twist: Twist | None = None
    q: list[float] | None = None
    base_motion: BaseMotionTable | None = None


class ObjectTable(_Solid, kw_only=True):
    """The held object: its mass, a solid or an inertia about the mass centre, and its initial pose and twist.

    The solid is as in `BodyTable`; `twist` is the initial [omega; v of its origin], world axes. What of it may touch
    the shapes of the world is in `touching`.
    """

    pose: PoseTable = msgspec.field(default_factory=PoseTable)
    twist: Twist = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    touching: TouchingTable | None = None


class ContactTable(KeyTable):
    """Friction of a unilateral contact."""

    mu: float
    torsion_radius: float | None = None
    half_length: float | None = None
    half_lengths: tuple[float, float] | None = None


class WrenchLimitsTable(KeyTable):
    """The largest moment [N m] and force [N] that a grasp can transmit."""

    moment: float | None = None
    force: float | None = None


class HoldTable(KeyTable):
    """A kind of grasp, and its contact frame in the frame of what is held, with z pointing `into` it."""

    kind: GraspName
    position: Triple = ZEROS
    quaternion: Quaternion | None = None
    rpy: Triple | None = None
    into: Triple | None = None
    pitch: float | None = None
    motion: list[Twist] | None = None
    stiffness: list[float | list[float]] | None = None
    damping: list[float | list[float]] | None = None
    contact: ContactTable | None = None
    wrench_limits: WrenchLimitsTable | None = None


class GraspTable(HoldTable, kw_only=True):
    """A grasp by an arm's tip, or by one of its links or `frames`; `of` is the name of the object, if it has one."""

    arm: str
    frame: str | None = None
    of: str | None = None


class LoopTable(HoldTable, kw_only=True):
    """A closure that is no grasp: a link or frame "arm/link", an object or the "world" `a` holds another one, `b`.

    The contact frame is in the frame of `b`, and `tip` the pose in that of `a` which attaches to it.
    """

    name: str
    a: str
    b: str
    tip: PoseTable | None = None


class CouplingTable(KeyTable):
    """A linear relation of joints "arm/joint", sum of coefficient times position = offset, or of their rates alone."""

    terms: dict[str, float]
    offset: float = 0.0
    rates_only: bool = False


class AttachTable(GraspTable, kw_only=True, tag_field="type", tag="attach"):
    """An arm grasps the object at time `t`, at the given frame or, with `here`, where its tip is at that time."""

    t: float
    here: bool = False


class ReleaseTable(KeyTable, tag_field="type", tag="release"):
    """An arm releases the object at time `t`."""

    t: float
    arm: str
    frame: str | None = None


class SpringEndTable(KeyTable):
    """An end of a spring: a point of "world", "object", or a link of an arm or of "trunk", in its frame [m]."""

    body: str
    point: Triple = ZEROS
    link: str | int | None = None


class SpringTable(KeyTable):
    """A spring and damper between two points [N/m, m, N s/m]."""

    a: SpringEndTable
    b: SpringEndTable
    stiffness: float
    length: float = 0.0
    damping: float = 0.0


class WrenchTable(KeyTable):
    """An external wrench on the object, or that named `of`, about its origin, world axes, from `begin` to `end`."""

    force: Triple = ZEROS
    moment: Triple = ZEROS
    begin: float = 0.0
    end: float | None = None
    of: str | None = None


class SimulationTable(KeyTable):
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
    contacts: Literal["events", "steps"] | None = None
    breakpoints: list[float] = []
    record: str | list[str] = EVERYTHING
    every: int = 1


class UniformTable(KeyTable, tag_field="type", tag="uniform"):
    """Every number is drawn uniformly between two bounds."""

    low: NumberRows
    high: NumberRows


class NormalTable(KeyTable, tag_field="type", tag="normal"):
    """Every number is drawn from a normal distribution."""

    mean: NumberRows
    deviation: NumberRows


class NearPoseTable(KeyTable, tag_field="type", tag="near_pose"):
    """Poses near those in the scene, rotated and shifted by up to `turn` and `shift` along each of their own axes."""

    turn: float = 0.0
    shift: float = 0.0


class SweepTable(KeyTable):
    """Many runs of the scene by `holdfast sweep`: their number, the varied parameters, and the recorded outputs."""

    count: int
    parameters: dict[str, UniformTable | NormalTable | NearPoseTable | NumberRows | Literal["scale"]]
    seed: int = 0
    chunk: int = 1000
    outputs: list[str] | None = None


class SceneTable(KeyTable):
    """A scene: the arms, their trunk if any, what they hold, grasps, a controller, and the simulation settings.

    Shapes of the `world` may touch the object. There is one `object`, or several `objects` by name, or none. `loops`
    and `couplings` are those of the whole chain. `recording` says which columns of a measured motion are what.
    `packages` are the folders of packages by name to which robot files refer, relative to the scene's folder.
    """

    arms: list[ArmTable]
    simulation: SimulationTable
    object: ObjectTable | None = None
    objects: dict[str, ObjectTable] = {}
    controller: ControllerTable | None = None
    trunk: TrunkTable | None = None
    grasps: list[GraspTable] = []
    loops: list[LoopTable] = []
    couplings: list[CouplingTable] = []
    events: list[AttachTable | ReleaseTable] = []
    wrenches: list[WrenchTable] = []
    springs: list[SpringTable] = []
    world: list[WorldTable] = []
    sweep: SweepTable | None = None
    recording: RecordingTable | None = None
    packages: dict[str, str] = {}
    gravity: Triple = STANDARD_GRAVITY
    name: str = ""
