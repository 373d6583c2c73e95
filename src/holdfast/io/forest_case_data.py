"""The layout of forward dynamics of forests in JSON (docs/cases.md), as typed data."""

from __future__ import annotations

from typing import Any

import msgspec

from holdfast.io.case_data import CaseMatrix3, CasePose, CaseStruct, CaseVector3, Vector6


class ForestJointData(CaseStruct):
    """A joint; its frame is (R0, p0) in the parent's frame."""

    type: str
    R0: CaseMatrix3
    p0: CaseVector3
    axis: CaseVector3 | None = None
    pitch: float | None = None
    across: CaseVector3 | None = None


class ForestBodyData(CaseStruct):
    """A body on a joint with its state; rates and torques in the axes of the joint's frame on the parent."""

    joint: ForestJointData
    mass: float
    com: CaseVector3
    inertia: CaseMatrix3
    q: list[float]
    qd: list[float]
    name: str = ""
    parent: int | None = None
    tau: list[float] | None = None
    armature: float = 0.0
    damping: float = 0.0
    wrench: Vector6 | None = None


class ForestClosureData(CaseStruct):
    """A closure between two bodies; null is the world."""

    a: int | None
    b: int
    type: str
    frame_a: CasePose
    frame_b: CasePose


class ForestCouplingData(CaseStruct):
    """A coupling: [body, component of its joint, coefficient] per term."""

    terms: list[tuple[int, int, float]]


class ForestExpected(CaseStruct):
    """The answer: per body, closure and coupling."""

    qdd: list[list[float]]
    alpha: list[Vector6]
    f: list[Vector6]
    coupling: list[float]


class ForestCaseData(CaseStruct):
    """One forest."""

    name: str
    gravity: CaseVector3
    bodies: list[ForestBodyData]
    closures: list[ForestClosureData] = msgspec.field(default_factory=list)
    couplings: list[ForestCouplingData] = msgspec.field(default_factory=list)
    expected: ForestExpected | None = None
    tags: Any = None
    debug: Any = None
    oracle: Any = None
    see: Any = None
