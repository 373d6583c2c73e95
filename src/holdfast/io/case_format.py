"""The format of problem cases: strict structures of a JSON file.

Arms list joints and links base to tip; matrices are row-major; SI units. `tags`, `debug`,
`oracle` and `see` are free-form, everything else is strict.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec

from holdfast.model.grasp import GraspName

Vector3 = Annotated[list[float], msgspec.Meta(min_length=3, max_length=3)]
Matrix3 = Annotated[list[Vector3], msgspec.Meta(min_length=3, max_length=3)]


class _Strict(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """Base of the file's structures."""


class BaseData(_Strict):
    """Pose and prescribed motion of an arm's base, world axes."""

    R: Matrix3
    p: Vector3
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


class LinkData(_Strict):
    """A link; inertia about the mass centre, link axes."""

    mass: float
    com: Vector3
    inertia: Matrix3


class GraspData(_Strict):
    """A grasp; point and free axes in object axes, W the relative rates."""

    type: GraspName
    point_object: Vector3
    h_object: list[Vector3] = []
    W: list[float] | None = None


class ArmData(_Strict):
    """An arm with its positions, rates and torques, base to tip."""

    base: BaseData
    joints: list[JointData]
    links: list[LinkData]
    tip: Vector3
    q: list[float]
    qd: list[float]
    tau: list[float]
    grasp: GraspData


class ObjectData(_Strict):
    """The object, its pose (R, p of point C) and velocity."""

    mass: float
    com: Vector3
    inertia: Matrix3
    R: Matrix3
    p: Vector3
    omega: Vector3
    v: Vector3


class ExpectedData(_Strict):
    """The answer: per arm, and alpha(C)."""

    qdd: list[list[float]]
    f: list[list[float]]
    alpha_C: list[float]
    W_dot: list[list[float]]


class CaseData(_Strict):
    """One problem."""

    name: str
    gravity: Vector3
    object: ObjectData
    arms: list[ArmData]
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
