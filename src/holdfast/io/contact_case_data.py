"""The layout of contacts with the world in JSON, as typed data; arms and object are those of `case_data`."""

from __future__ import annotations

from typing import Any, Literal

from holdfast.io.case_data import CaseArm, CaseObject, CaseStruct, CaseTrunk, CaseVector3, Vector6


class CaseContact(CaseStruct):
    """A point of the object on the surface of a half-space, whose normal points into the object."""

    point_object: CaseVector3
    normal: CaseVector3
    offset: float
    mu: float


class ContactExpected(CaseStruct):
    """The answer: forces with accelerations, or impulses with the velocities just after."""

    modes: list[Literal["open", "sticks", "slips", "closed"]]
    contact_force_unique: bool
    object_wrench: Vector6
    contact_force: list[CaseVector3] | None = None
    margin: float | None = None
    object_twist: Vector6 | None = None
    qd: list[list[float]] | None = None
    grasp_impulse: list[Vector6] | None = None
    energy_change: float | None = None
    qdd: list[list[float]] | None = None
    f: list[Vector6] | None = None
    alpha_C: Vector6 | None = None


class ContactCaseData(CaseStruct):
    """A chain whose object touches the world at one instant."""

    name: str
    kind: Literal["impact", "rest", "sliding"]
    gravity: CaseVector3
    object: CaseObject
    arms: list[CaseArm]
    contacts: list[CaseContact]
    trunk: CaseTrunk | None = None
    solutions: int = 1
    expected: ContactExpected | None = None
    tags: Any = None
    debug: Any = None
    oracle: Any = None
    see: Any = None


class RodExpected(CaseStruct):
    """The answer for a rod."""

    p: float
    free_normal_acceleration: float
    normal_force: float | None = None
    words: str = ""


class RodCaseData(CaseStruct):
    """Painleve's rod: uniform, its lower end slides on a floor."""

    name: str
    kind: Literal["rod"]
    mass: float
    half_length: float
    inertia: float
    angle: float
    rate: float
    slide: float
    mu: float
    gravity: float
    solutions: int = 1
    expected: RodExpected | None = None
    tags: Any = None
    see: Any = None
