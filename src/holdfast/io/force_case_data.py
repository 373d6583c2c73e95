"""The layout of questions about forces in JSON, as typed data; arms, trunk and object are those of `case_data`."""

from __future__ import annotations

import math
from typing import Any, Literal

import msgspec

from holdfast.io.case_data import (
    CaseMatrix3,
    CaseMechanism,
    CaseObject,
    CaseStruct,
    CaseTrunkMechanism,
    CaseVector3,
    Vector6,
)

ForceForm = Literal["effort", "margin", "peak", "scale"]
AccelerationRange = tuple[str, int, float, float]


class ForceFriction(CaseStruct):
    """The friction of a one-sided contact."""

    mu: float
    torsion_radius: float | None = None
    half_length: float | None = None
    half_lengths: tuple[float, float] | None = None


class ForceWrenchLimits(CaseStruct):
    """The largest wrench that a grasp can hold."""

    force: float = math.inf
    moment: float = math.inf


class ForceGrasp(CaseStruct):
    """A grasp; the contact frame's columns x, y, z in object axes, z into the object."""

    type: Literal["rigid", "sole", "hinge", "softfinger", "ball", "universal", "slider", "cylinder", "planar"]
    point_object: CaseVector3
    frame_object: CaseMatrix3
    friction: ForceFriction | None = None
    wrench_limits: ForceWrenchLimits | None = None
    least_normal: float | None = None
    most_normal: float | None = None
    W: list[float] | None = None
    name: str | None = None


class ForceArm(CaseMechanism, kw_only=True):
    """An arm whose torques are asked."""

    grasp: ForceGrasp | None = None


class ForceQuestionData(CaseStruct):
    """What is asked, by the object's acceleration or rows on it, and in which units forces count."""

    form: ForceForm
    acceleration: list[float]
    force_scale: float
    task: list[Vector6] | None = None
    hold: Vector6 | None = None
    wish: dict[str, Vector6] = msgspec.field(default_factory=dict)
    eps_force: float = 0.01
    eps_acceleration: float = 0.01
    acceleration_limits: list[AccelerationRange] = msgspec.field(default_factory=list)


class ForceExpected(CaseStruct):
    """The answer."""

    status: Literal["optimal", "infeasible", "weakly infeasible"]
    value: float | None = None
    tau: list[float] | None = None
    qdd: list[float] | None = None
    alpha_C: Vector6 | None = None
    f: list[Vector6] | None = None
    prices: dict[str, list[float]] | None = None
    margin: float | None = None
    peak: float | None = None
    scale: float | None = None
    least_violation: float | None = None
    certificate: dict[str, list[float]] | None = None
    unique: bool | None = None
    accuracy: float | None = None
    violation_accuracy: float | None = None
    residual_of_equalities: float | None = None


class ForceCaseData(CaseStruct):
    """One question about forces."""

    name: str
    gravity: CaseVector3
    object: CaseObject
    arms: list[ForceArm]
    question: ForceQuestionData
    trunk: CaseTrunkMechanism | None = None
    expected: ForceExpected | None = None
    tags: Any = None
    debug: Any = None
    oracle: Any = None
    see: Any = None
