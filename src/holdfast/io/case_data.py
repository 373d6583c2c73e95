"""The layout of problem cases in JSON, versions 1 and 2, as typed data."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec

CaseVector3 = Annotated[list[float], msgspec.Meta(min_length=3, max_length=3)]
Vector6 = Annotated[list[float], msgspec.Meta(min_length=6, max_length=6)]
CaseMatrix3 = Annotated[list[CaseVector3], msgspec.Meta(min_length=3, max_length=3)]


class CaseStruct(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """Base of the file's structures."""


class CasePose(CaseStruct):
    """A pose in the world."""

    R: CaseMatrix3
    p: CaseVector3


class CaseTwist(CaseStruct):
    """A velocity, world axes."""

    omega: CaseVector3
    v: CaseVector3


class CaseBase(CasePose, kw_only=True):
    """Pose and prescribed motion of an arm's base, world axes."""

    omega: CaseVector3 = msgspec.field(default_factory=lambda: [0.0, 0.0, 0.0])
    v: CaseVector3 = msgspec.field(default_factory=lambda: [0.0, 0.0, 0.0])
    omega_dot: CaseVector3 = msgspec.field(default_factory=lambda: [0.0, 0.0, 0.0])
    v_dot: CaseVector3 = msgspec.field(default_factory=lambda: [0.0, 0.0, 0.0])


class CaseJoint(CaseStruct):
    """A joint; its link's frame at q = 0 is (R0, p0) in the parent frame."""

    type: Literal["revolute", "prismatic"]
    axis: CaseVector3
    R0: CaseMatrix3
    p0: CaseVector3
    armature: float = 0.0
    damping: float = 0.0
    effort: float | None = None


class CaseFloating(CaseStruct):
    """The joint of a trunk that begins with a free body."""

    type: Literal["floating"]


class CaseLink(CaseStruct):
    """A link; inertia about the mass centre, link axes; an external wrench about its frame's origin, world axes."""

    mass: float
    com: CaseVector3
    inertia: CaseMatrix3
    wrench: Vector6 | None = None


class CaseGrasp(CaseStruct):
    """A grasp; point and free axes in object axes, W the relative rates."""

    type: Literal["rigid", "hinge", "softfinger", "ball"]
    point_object: CaseVector3
    h_object: list[CaseVector3] = []
    W: list[float] | None = None


class CaseMechanism(CaseStruct):
    """An arm with its positions and rates, base to tip.

    `parent` is the trunk's link that it stands on, `base` a pose in that link's frame then; null: in the world.
    """

    base: CaseBase
    joints: list[CaseJoint]
    links: list[CaseLink]
    tip: CaseVector3
    q: list[float]
    qd: list[float]
    parent: int | None = None
    name: str | None = None


class CaseArm(CaseMechanism, kw_only=True):
    """An arm with its torques; without a grasp it is free."""

    tau: list[float]
    grasp: CaseGrasp | None = None


class CaseTrunkMechanism(CaseStruct):
    """A trunk: like an arm on a base, or beginning with a floating joint, whose body `pose` and `twist` are of."""

    joints: list[Any]
    links: list[CaseLink]
    q: list[float]
    qd: list[float]
    base: CaseBase | None = None
    pose: CasePose | None = None
    twist: CaseTwist | None = None


class CaseTrunk(CaseTrunkMechanism, kw_only=True):
    """A trunk with its torques."""

    tau: list[float]


class CaseObject(CasePose, kw_only=True):
    """The object, its pose (R, p of point C) and velocity."""

    mass: float
    com: CaseVector3
    inertia: CaseMatrix3
    omega: CaseVector3
    v: CaseVector3
    wrench: Vector6 | None = None


class ExpectedTrunk(CaseStruct):
    """The trunk's answer: its joints, and how a floating base accelerates or the wrench that a fixed one takes."""

    qdd: list[float]
    acceleration: Vector6 | None = None
    base_wrench: Vector6 | None = None


class CaseExpected(CaseStruct):
    """The answer: per arm, and alpha(C)."""

    qdd: list[list[float]]
    f: list[list[float]]
    alpha_C: list[float]
    W_dot: list[list[float]]
    base_wrench: list[Vector6] | None = None
    trunk: ExpectedTrunk | None = None


class CaseData(CaseStruct):
    """One problem."""

    name: str
    gravity: CaseVector3
    object: CaseObject
    arms: list[CaseArm]
    trunk: CaseTrunk | None = None
    expected: CaseExpected | None = None
    tags: Any = None
    debug: Any = None
    oracle: Any = None
    see: Any = None


class CaseFileData(CaseStruct):
    """A file of many problems."""

    cases: list[Any]
    format: str = ""
    version: Any = None
    units: Any = None
    see: Any = None
