"""Forests: bodies on joints, free bodies, closures between any two of them, and couplings of joints.

A floating base and a held object are one thing, a free body. Arms, trunks, hands, parallelograms and several objects
are all forests; a `ClosedChain` is one, too (`ClosedChain.forest`). See docs/theory/tree.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.closure import Closure
from holdfast.model.joint_kinds import JOINT_KINDS, JointKind
from holdfast.model.link import Link
from holdfast.names import called
from holdfast.spatial.frozen import NOT_GIVEN, ArrayField, Frozen, OptionalArrayField, frozen_property, making
from holdfast.spatial.pose import Pose, PoseField
from holdfast.spatial.scalar import Array

GROUND = -1  # index of the world among the bodies, as the parent of a body or the first end of a closure

JointName = Literal["revolute", "prismatic", "screw", "cylindrical", "planar", "spherical", "free"]


@called
@dataclass(frozen=True, eq=False)
class BodyJoint(Frozen):
    """A joint with one to six degrees of freedom, between a body and its parent.

    R = R_parent R0 Q, p = p_parent + R_parent (p0 + R0 d) with the displacement (Q, d) of its kind; see `JOINT_KINDS`.

    Attributes:
        kind: "revolute", "prismatic", "screw", "cylindrical", "planar", "spherical" or "free".
        placement: pose of the joint's frame in the parent's frame (R0, p0); that of a free body is the identity.
        axis: (3,) unit axis in the axes of the joint's frame; a planar joint turns about it. Spherical and free joints
            have none.
        across: (3,) unit direction e perpendicular to the axis; a planar joint shifts along e and axis x e.
        pitch: translation along the axis per radian, for a screw [m/rad].
        armature: inertia of the drive of every degree of freedom, reflected to the joint, >= 0 [kg m^2 or kg].
        damping: viscous damping of every degree of freedom, >= 0 [N m s/rad or N s/m].
        stiffness: stiffness k of a spring in a joint with one degree of freedom, with the torque -k (q - rest), >= 0
            [N m/rad or N/m].
        rest: q at which that spring is slack [rad or m].
        actuated: False for a joint without a drive, which `forest_inverse_dynamics` gives no torque. A free body has
            none, either.
    """

    kind: JointName = "revolute"
    placement: PoseField = field(default_factory=making(Pose.identity))
    axis: ArrayField = field(default_factory=making(np.array, [0.0, 0.0, 1.0]))
    across: OptionalArrayField = NOT_GIVEN
    pitch: float | None = None
    armature: float = 0.0
    damping: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0
    actuated: bool = True

    def __post_init__(self) -> None:
        put = object.__setattr__
        checks.instance(self.actuated, bool, "joint: actuated")
        if not isinstance(self.kind, str) or self.kind not in JOINT_KINDS:
            raise ModelError(
                f"joint: kind: got {checks.short(self.kind)}.{checks.did_you_mean(str(self.kind), JOINT_KINDS)}"
            )
        put(self, "placement", checks.pose(self.placement, "joint: placement"))
        if self.of_kind.floats and not (np.array_equal(self.placement.R, np.eye(3)) and not self.placement.p.any()):
            raise ModelError("joint: placement: expected the identity for a free body, whose pose is its position")
        put(self, "axis", checks.unit_vector(self.axis, "joint: axis"))
        for name in ("across", "pitch"):
            if (getattr(self, name) is None) == (self.of_kind.needs == name):
                verb = "needs" if self.of_kind.needs == name else "has no"
                raise ModelError(f"joint: {name}: a {self.kind} joint {verb} {name}")
        if self.pitch is not None:
            put(self, "pitch", checks.number(self.pitch, "joint: pitch"))
        if self.across is not None:
            put(self, "across", checks.unit_vector(self.across, "joint: across"))
            if abs(self.across @ self.axis) > checks.ROTATION_TOLERANCE:
                raise ModelError("joint: across: expected a direction perpendicular to the axis")
        for name in ("armature", "damping", "stiffness"):
            put(self, name, checks.number(getattr(self, name), f"joint: {name}", at_least=0.0))
            if self.of_kind.floats and getattr(self, name):
                raise ModelError(f"joint: {name}: expected 0, as nothing drives or damps a free body")
        put(self, "rest", checks.number(self.rest, "joint: rest"))
        if self.stiffness and self.of_kind.freedoms > 1:
            raise ModelError(
                f"joint: stiffness: expected 0 for a {self.kind} joint, which turns or shifts in many ways"
            )

    @property
    def of_kind(self) -> JointKind:
        """The properties of its kind."""
        return JOINT_KINDS[self.kind]

    @frozen_property
    def rate_map(self) -> Array:
        """(6, m) [A; B], the twist of the body relative to its parent per rate, in the axes of the joint's frame."""
        across = self.axis if self.across is None else self.across
        return np.array(self.of_kind.columns(self.axis, across, self.pitch or 0.0)).T

    def displacement(self, q: Array) -> tuple[Array, Array]:
        """Return rotation Q (3, 3) and translation d (3,) of the body's frame in the joint's frame at positions q."""
        return self.of_kind.displacement(self.rate_map, self.axis, q)


@called
@dataclass(frozen=True, eq=False)
class ForestBody(Frozen):
    """A rigid body, and the joint between it and its parent.

    Attributes:
        link: mass, mass centre and inertia; its name is that of the body.
        joint: the joint.
        parent: index of the parent in the forest, which comes before the body; None for the world.
    """

    link: Link
    joint: BodyJoint
    parent: int | None = None

    def __post_init__(self) -> None:
        checks.instance(self.link, Link, "body: link")
        checks.instance(self.joint, BodyJoint, "body: joint")
        if self.joint.of_kind.floats:
            if self.parent is not None:
                raise ModelError(f"body: parent: expected None for a free body, got {checks.short(self.parent)}")
            checks.number(self.link.mass, "body: mass of a free body", above=0.0)
            checks.rotational_inertia(
                self.link.inertia, "body: inertia of a free body", definite=True, physical=self.link.physical
            )


@called
@dataclass(frozen=True, eq=False)
class JointCoupling(Frozen):
    """A linear relation between joint rates, sum c qd = 0: a mimic joint, a gear, or a locked joint (one term).

    Its multiplier lambda acts on each joint with the torque or force c lambda.

    Attributes:
        terms: per joint, the index of its body, the component of its qd, and the coefficient c, which is not zero.
        offset: of the positions, sum c q = offset, which `forest_close` satisfies; None to keep the sum as it is.
        name: name in messages.
    """

    terms: Sequence[tuple[int, int, float]]
    offset: float | None = None
    name: str = ""

    def __post_init__(self) -> None:
        checks.name(self.name, "coupling: name")
        found = []
        if not isinstance(self.terms, Sequence) or not self.terms:
            raise ModelError("coupling: terms: expected at least one (body, component, coefficient)")
        for term in self.terms:
            if not isinstance(term, Sequence) or len(term) != 3:
                raise ModelError(f"coupling: terms: expected (body, component, coefficient), got {checks.short(term)}")
            coefficient = checks.number(term[2], "coupling: coefficient")
            if coefficient == 0.0:
                raise ModelError("coupling: coefficient: expected another number than 0; try leaving the joint out")
            for name, index in (("body", term[0]), ("component", term[1])):
                if not _is_index(index):
                    raise ModelError(f"coupling: {name}: expected an index, got {checks.short(index)}")
            found.append((int(term[0]), int(term[1]), coefficient))
        if len({term[:2] for term in found}) < len(found):
            raise ModelError("coupling: terms: expected each component once; try the sum of its coefficients")
        object.__setattr__(self, "terms", tuple(found))
        if self.offset is not None:
            object.__setattr__(self, "offset", checks.number(self.offset, "coupling: offset"))


@called
@dataclass(frozen=True, eq=False)
class Forest(Frozen):
    """Bodies on joints, free bodies, closures and couplings, in a fixed order.

    Attributes:
        bodies: the bodies, every parent before its children. Their order is that of all flat arrays: q with n_q entries
            a joint (a spherical joint: wxyz; a free one: wxyz_xyz), and qd, qdd and tau with n_v entries (a spherical
            joint: relative angular velocity in the axes of its frame on the parent; a free one: the twist of the body's
            origin, world axes).
        closures: constraints between two of them, or one and the world.
        couplings: relations between joint rates.
        gravity: (3,) gravitational acceleration, world axes [m/s^2].
    """

    bodies: Sequence[ForestBody]
    closures: Sequence[Closure] = ()
    couplings: Sequence[JointCoupling] = ()
    gravity: ArrayField = field(default_factory=making(np.array, (0.0, 0.0, -9.81)))

    def __post_init__(self) -> None:
        put = object.__setattr__
        for name, kind in (("bodies", ForestBody), ("closures", Closure), ("couplings", JointCoupling)):
            given = getattr(self, name)
            if not isinstance(given, Sequence) or not all(isinstance(one, kind) for one in given):
                raise ModelError(f"forest: {name}: expected a list of {kind.__name__}, got {checks.short(given)}")
            put(self, name, tuple(given))
        if not self.bodies:
            raise ModelError("forest: bodies: expected at least one, got none")
        put(self, "gravity", checks.numbers(self.gravity, (3,), "forest: gravity"))
        for k, body in enumerate(self.bodies):
            if body.parent is not None:
                _index(body.parent, k, f"forest: body {k}: parent", "a body before it, or None for the world")
        for i, closure in enumerate(self.closures):
            for end in ("a", "b"):
                if end == "b" or closure.a is not None:
                    _index(getattr(closure, end), len(self.bodies), f"forest: closure {i}: {end}", "a body")
            if closure.a == closure.b:
                raise ModelError(f"forest: closure {i}: expected two bodies, got body {closure.b} at both ends")
        for i, coupling in enumerate(self.couplings):
            for body, component, _ in coupling.terms:
                _index(body, len(self.bodies), f"forest: coupling {i}: body", "a body")
                kind = self.bodies[body].joint.of_kind
                if kind.floats:
                    raise ModelError(f"forest: coupling {i}: body {body} is free; expected one on a joint")
                _index(component, kind.freedoms, f"forest: coupling {i}: component", "a component of the joint")
                if coupling.offset is not None and kind.pose:
                    raise ModelError(
                        f"forest: coupling {i}: offset: body {body} is on a {self.bodies[body].joint.kind} joint, whose"
                        " positions are no sums of angles; try None"
                    )

    def __repr__(self) -> str:
        """Return the numbers of bodies, closures and couplings, on one line."""
        free = sum(body.joint.of_kind.floats for body in self.bodies)
        return (
            f"<Forest: {len(self.bodies)} bodies ({free} free), {len(self.closures)} closures,"
            f" {len(self.couplings)} couplings>"
        )

    @frozen_property
    def topology(self) -> Topology:
        """Who hangs on whom and what is closed with what, without any number."""
        return Topology(
            tuple(GROUND if body.parent is None else body.parent for body in self.bodies),
            tuple(body.joint.of_kind.floats for body in self.bodies),
            tuple((GROUND if c.a is None else int(c.a), int(c.b)) for c in self.closures),
            tuple(tuple(sorted({body for body, _, _ in coupling.terms})) for coupling in self.couplings),
        )

    @frozen_property
    def positions(self) -> tuple[slice, ...]:
        """Per body, the slice of its joint in q."""
        return _slices(body.joint.of_kind.position_count for body in self.bodies)

    @frozen_property
    def velocities(self) -> tuple[slice, ...]:
        """Per body, the slice of its joint in qd, qdd and tau."""
        return _slices(body.joint.of_kind.freedoms for body in self.bodies)

    @frozen_property
    def quaternions(self) -> tuple[tuple[slice, slice], ...]:
        """Of every unit quaternion in q its slice there, and that of its angular velocity in qd."""
        bodies = zip(self.bodies, self.positions, self.velocities, strict=True)
        return tuple(
            (slice(at_q.start, at_q.start + 4), slice(at_v.start, at_v.start + 3))
            for body, at_q, at_v in bodies
            if body.joint.of_kind.pose
        )

    @property
    def position_count(self) -> int:
        """Length n_q of q."""
        return self.positions[-1].stop

    @property
    def velocity_count(self) -> int:
        """Length n_v of qd, qdd and tau."""
        return self.velocities[-1].stop

    def poses(self, q: Array) -> list[Pose]:
        """Return the pose of every body's frame in the world at positions q (n_q,). O(bodies)."""
        found: list[Pose] = []
        for body, part in zip(self.bodies, self.positions, strict=True):
            at = body.joint.placement @ Pose.unchecked(*body.joint.displacement(q[part]))
            found.append(at if body.parent is None else found[body.parent] @ at)
        return found

    @property
    def constraint_row_count(self) -> int:
        """Number of rows of the constraint on qd: those of closures, without their free directions, and couplings."""
        return sum(len(c.grasp.transmitted) for c in self.closures) + len(self.couplings)


@dataclass(frozen=True)
class Topology:
    """The graph of a forest, on which alone the order of its elimination depends; it can be hashed.

    Attributes:
        parents: per body, its parent; `GROUND` for the world.
        free: per body, whether it is free.
        ends: per closure, its two bodies.
        coupled: per coupling, the bodies whose joints are coupled.
    """

    parents: tuple[int, ...]
    free: tuple[bool, ...]
    ends: tuple[tuple[int, int], ...]
    coupled: tuple[tuple[int, ...], ...]


def _slices(counts: Iterable[int]) -> tuple[slice, ...]:
    found, start = [], 0
    for count in counts:
        found.append(slice(start, start + count))
        start += count
    return tuple(found)


def _index(value: Any, count: int, what: str, expected: str) -> None:
    if not _is_index(value) or not value < count:
        among = f"0 .. {count - 1}" if count else "none"
        raise ModelError(f"{what}: expected the index of {expected} ({among}), got {checks.short(value)}")


def _is_index(value: Any) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool) and bool(value >= 0)
