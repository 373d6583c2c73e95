"""The layout of problem cases in JSON, versions 1 and 2, as typed data."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec

Vector3 = Annotated[list[float], msgspec.Meta(min_length=3, max_length=3)]
Vector6 = Annotated[list[float], msgspec.Meta(min_length=6, max_length=6)]
Matrix3 = Annotated[list[Vector3], msgspec.Meta(min_length=3, max_length=3)]


class _Strict(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """Base of the file's structures."""


class PoseData(_Strict):
    """A pose in the world."""

    R: Matrix3
    p: Vector3


class TwistData(_Strict):
    """A velocity, world axes."""

    omega: Vector3
    v: Vector3


class BaseData(PoseData, kw_only=True):
    """Pose and prescribed motion of an arm's base, world axes."""

    omega: Vector3 = msgspec.field(default_factory=lambda: [0.0, 0.0, 0.0])
    v: Vector3 = msgspec.field(default_factory=lambda: [0.0, 0.0, 0.0])
    omega_dot: Vector3 = msgspec.field(default_factory=lambda: [0.0, 0.0, 0.0])
    v_dot: Vector3 = msgspec.field(default_factory=lambda: [0.0, 0.0, 0.0])


class JointData(_Strict):
    """A joint; its link's frame at q = 0 is (R0, p0) in the parent frame."""

    type: Literal["revolute", "prismatic"]
    axis: Vector3
    R0: Matrix3
    p0: Vector3
    armature: float = 0.0
    damping: float = 0.0


class FloatingData(_Strict):
    """The joint of a trunk that begins with a free body."""

    type: Literal["floating"]


class LinkData(_Strict):
    """A link; inertia about the mass centre, link axes; an external wrench about its frame's origin, world axes."""

    mass: float
    com: Vector3
    inertia: Matrix3
    wrench: Vector6 | None = None


class GraspData(_Strict):
    """A grasp; point and free axes in object axes, W the relative rates."""

    type: Literal["rigid", "hinge", "softfinger", "ball"]
    point_object: Vector3
    h_object: list[Vector3] = []
    W: list[float] | None = None


class ArmData(_Strict):
    """An arm with its positions, rates and torques, base to tip.

    `parent` is the trunk's link that it stands on, `base` a pose in that link's frame then; null: in the world. An arm
    without a grasp is free.
    """

    base: BaseData
    joints: list[JointData]
    links: list[LinkData]
    tip: Vector3
    q: list[float]
    qd: list[float]
    tau: list[float]
    grasp: GraspData | None = None
    parent: int | None = None


class TrunkData(_Strict):
    """A trunk: like an arm on a base, or beginning with a floating joint, whose body `pose` and `twist` are of."""

    joints: list[Any]
    links: list[LinkData]
    q: list[float]
    qd: list[float]
    tau: list[float]
    base: BaseData | None = None
    pose: PoseData | None = None
    twist: TwistData | None = None


class ObjectData(PoseData, kw_only=True):
    """The object, its pose (R, p of point C) and velocity."""

    mass: float
    com: Vector3
    inertia: Matrix3
    omega: Vector3
    v: Vector3
    wrench: Vector6 | None = None


class ExpectedTrunk(_Strict):
    """The trunk's answer: its joints, and how a floating base accelerates or the wrench that a fixed one takes."""

    qdd: list[float]
    acceleration: Vector6 | None = None
    base_wrench: Vector6 | None = None


class ExpectedData(_Strict):
    """The answer: per arm, and alpha(C)."""

    qdd: list[list[float]]
    f: list[list[float]]
    alpha_C: list[float]
    W_dot: list[list[float]]
    base_wrench: list[Vector6] | None = None
    trunk: ExpectedTrunk | None = None


class CaseData(_Strict):
    """One problem."""

    name: str
    gravity: Vector3
    object: ObjectData
    arms: list[ArmData]
    trunk: TrunkData | None = None
    expected: ExpectedData | None = None
    tags: Any = None
    debug: Any = None
    oracle: Any = None
    see: Any = None


class CaseFileData(_Strict):
    """A file of many problems."""

    cases: list[Any]
    format: str = ""
    version: Any = None
    units: Any = None
    see: Any = None
