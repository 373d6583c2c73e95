"""The format of scenes: strict structures of a TOML file. SI units, world axes, +z up."""

from __future__ import annotations

import msgspec

from holdfast.model.closed_chain import STANDARD_GRAVITY
from holdfast.model.grasp import GraspKind

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Matrix3 = tuple[Vector3, Vector3, Vector3]
ZEROS: Vector3 = (0.0, 0.0, 0.0)


class _Strict(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """Base of the file's structures."""


class PoseData(_Strict):
    """A pose: position and, as quaternion (w, x, y, z) or as roll, pitch, yaw, an attitude."""

    position: Vector3 = ZEROS
    quaternion: Quaternion | None = None
    rpy: Vector3 | None = None


class ArmData(_Strict):
    """An arm: a robot's name, where it stands, its tool and where its joints begin.

    `tip` is the pose of a massless tool's tip in the robot's own tip frame. `q` is a guess
    from which the arm is moved to its grasp; the robot's home posture without it.
    """

    name: str
    robot: str
    base: PoseData = msgspec.field(default_factory=PoseData)
    tip: PoseData | None = None
    q: list[float] | None = None


class ObjectData(_Strict):
    """The held object: mass, and the edges of a solid box or an inertia about the mass centre."""

    mass: float
    box: Vector3 | None = None
    inertia: Matrix3 | None = None
    com: Vector3 = ZEROS
    pose: PoseData = msgspec.field(default_factory=PoseData)


class ContactData(_Strict):
    """Friction of a one-sided contact."""

    mu: float
    torsion_radius: float | None = None
    half_length: float | None = None


class GraspData(_Strict):
    """A grasp: the contact frame in object axes, z into the object."""

    arm: str
    kind: GraspKind
    position: Vector3 = ZEROS
    quaternion: Quaternion | None = None
    rpy: Vector3 | None = None
    contact: ContactData | None = None


class PathData(_Strict):
    """A smooth motion of the object from rest to rest, world axes."""

    duration: float
    displacement: Vector3 = ZEROS
    turn: Vector3 = ZEROS
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


class SimulationData(_Strict):
    """How long, and in which steps."""

    duration: float
    step: float


class SceneData(_Strict):
    """A scene: arms, the object they hold, a controller, and how long to simulate."""

    arms: list[ArmData]
    object: ObjectData
    controller: GravityCompensationData | ObjectTrackingData
    simulation: SimulationData
    grasps: list[GraspData] = msgspec.field(default_factory=list)
    gravity: Vector3 = STANDARD_GRAVITY
    name: str = ""
