"""Joints between links."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.fingerprint import ADDED, OMITTED
from holdfast.model.joint_types import JOINT_TYPES, JointType
from holdfast.names import called
from holdfast.spatial.frozen import ArrayField, Converted, Frozen, frozen_property, making
from holdfast.spatial.pose import Pose, PoseField
from holdfast.spatial.scalar import Array
from holdfast.spatial.vector import outer, skew

PER_FREEDOM = ("rate_limit", "effort_limit", "armature", "damping", "friction", "stiffness", "rest")
UNBOUNDED: Any = (-np.inf, np.inf)  # Any, because type checkers do not accept a tuple as a `Converted`


ArmJointName = Literal["revolute", "prismatic", "screw", "cylindrical", "planar", "spherical"]


@called
@dataclass(frozen=True, eq=False)
class Joint(Frozen):
    """A joint between a link and its parent (the previous link, or the base).

    Revolute: R = R_parent R0 Rot(axis, q), p = p_parent + R_parent p0.
    Prismatic: R = R_parent R0, p = p_parent + R_parent (p0 + R0 axis q).
    Other types of `JOINT_TYPES` combine both; see `JointType`. In an `Arm`, a joint with several degrees of freedom is
    replaced by as many joints, with massless links between them. Its limits, armature, damping, friction and spring are
    then one value for all of them, or a sequence with one value each. A planar joint shifts along two directions across
    its axis, x and y for an axis along z, y and z for x, z and x for y, and then rotates about it. A spherical joint
    has a unit quaternion wxyz in q and an angular velocity in the axes of its frame on the parent in qd; chains with
    one are answered as forests (docs/how_to/branches.md).

    Attributes:
        kind: "revolute" [rad], "prismatic" [m], "screw" [rad], "cylindrical", "planar" or "spherical".
        axis: (3,) unit vector in the axes of the link that it moves.
        placement: pose of that link's frame at q = 0 in the parent frame (R0, p0).
        name: name in messages.
        position_limits: lowest and highest q [rad or m].
        rate_limit: largest |qd| [rad/s or m/s].
        effort_limit: largest |tau| [N m or N].
        armature: inertia of the drive, reflected to the joint, >= 0 [kg m^2 or kg].
        damping: viscous damping, >= 0 [N m s/rad or N s/m].
        friction: Coulomb friction, >= 0 [N m or N]; used by simulation and identification only.
        stiffness: stiffness k of a spring in the joint with the torque -k (q - rest), >= 0 [N m/rad or N/m].
        rest: q at which that spring is slack [rad or m].
        pitch: translation along the axis per radian, for a screw [m/rad].
        actuated: False for a passive joint, whose torque is zero but for its spring and dampers.
    """

    kind: ArmJointName = "revolute"
    axis: ArrayField = field(default_factory=making(np.array, [0.0, 0.0, 1.0]))
    placement: PoseField = field(default_factory=making(Pose.identity))
    name: str = ""
    position_limits: Converted[tuple[float, float], ArrayLike] = UNBOUNDED
    rate_limit: float = np.inf
    effort_limit: float = np.inf
    armature: float = 0.0
    damping: float = 0.0
    friction: float = 0.0
    stiffness: float = field(default=0.0, metadata=ADDED)
    rest: float = field(default=0.0, metadata=ADDED)
    pitch: float | None = field(default=None, metadata=OMITTED)
    actuated: bool = field(default=True, metadata=OMITTED)

    def __post_init__(self) -> None:
        checks.name(self.name, "joint: name")
        label = f"joint '{self.name}'" if self.name else "joint"
        if not isinstance(self.kind, str) or self.kind not in JOINT_TYPES:
            expected = " or ".join(map(repr, JOINT_TYPES))
            raise ModelError(f"{label}: kind: expected {expected}, got {checks.short(self.kind)}")
        put = object.__setattr__
        checks.instance(self.actuated, bool, f"{label}: actuated")
        if self.type.threaded != (self.pitch is not None):
            needed = "needs a pitch [m/rad]" if self.type.threaded else "has no pitch"
            raise ModelError(f"{label}: pitch: a {self.kind} joint {needed}")
        if self.pitch is not None:
            put(self, "pitch", checks.number(self.pitch, f"{label}: pitch"))
        if self.type.parts:
            self._require_parts(label)
            return
        put(self, "axis", checks.unit_vector(self.axis, f"{label}: axis"))
        put(self, "placement", checks.pose(self.placement, f"{label}: placement"))
        for quantity in ("armature", "damping", "friction", "stiffness"):
            put(self, quantity, checks.number(getattr(self, quantity), f"{label}: {quantity}", at_least=0.0))
        put(self, "rest", checks.number(self.rest, f"{label}: rest"))
        for quantity in ("rate_limit", "effort_limit"):
            put(self, quantity, checks.limit(getattr(self, quantity), f"{label}: {quantity}"))
        limits = checks.real_array(self.position_limits, f"{label}: position_limits", "two numbers", ModelError)
        if limits.shape != (2,):
            raise ModelError(
                f"{label}: position_limits: expected two numbers, got {checks.short(self.position_limits)}"
            )
        low, high = map(float, limits)
        if not low <= high:
            raise ModelError(f"{label}: position_limits: expected lower <= upper, got {low:g} and {high:g}")
        put(self, "position_limits", (low, high))
        if self.type.quaternion:
            given = [
                name
                for name in ("rate_limit", "effort_limit", "position_limits")
                if np.isfinite(getattr(self, name)).any()
            ]
            given += [name for name in ("friction", "stiffness") if getattr(self, name)]
            if given:
                raise ModelError(
                    f"{label}: {given[0]}: expected none for a {self.kind} joint, which has armature and damping only"
                )

    @property
    def parts(self) -> tuple[Joint, ...]:
        """The joints with one degree of freedom that replace this one, in order from the parent to the link."""
        chain = self.type.parts
        if not chain:
            return (self,)
        given = {name: _one_each(getattr(self, name), len(chain)) for name in PER_FREEDOM}
        ranges = self.position_limits if np.ndim(self.position_limits) == 2 else [self.position_limits] * len(chain)
        return tuple(
            Joint(
                kind,  # pyright: ignore[reportArgumentType]
                own_axis(self.axis),
                self.placement if k == 0 else Pose.identity(),
                f"{self.name}.{k + 1}" if self.name else "",
                ranges[k],
                **{name: values[k] for name, values in given.items()},
                actuated=self.actuated,
            )
            for k, (kind, own_axis) in enumerate(chain)
        )

    def _require_parts(self, label: str) -> None:
        """Check a joint with several degrees of freedom, whose values are one for all of them or one for each."""
        object.__setattr__(self, "axis", checks.unit_vector(self.axis, f"{label}: axis"))
        count = len(self.type.parts)
        for name in (*PER_FREEDOM, "position_limits"):
            value = checks.real_array(getattr(self, name), f"{label}: {name}", f"one value or {count}", ModelError)
            alone = 1 if name == "position_limits" else 0
            if value.ndim > alone and len(value) != count:
                raise ModelError(f"{label}: {name}: expected one value or {count}, got {len(value)}")
        assert len(self.parts) == count  # checks each of them

    @property
    def type(self) -> JointType:
        """The properties of its kind."""
        return JOINT_TYPES[self.kind]

    @property
    def turns(self) -> bool:
        """Whether q is an angle [rad]; otherwise it is a length [m]."""
        return self.type.turns

    @property
    def travel(self) -> float:
        """Translation of the link along the axis per unit of q [m/rad or 1]."""
        return self.type.travel if self.pitch is None else self.pitch

    @frozen_property
    def motion_subspace(self) -> tuple[Any, Any]:
        """H^T = [h; s] in link axes: angular part (3,) and linear part (3,), None for a part that is zero."""
        h = self.axis if self.type.turns else None
        return h, self.travel * self.axis if self.travel else None

    @frozen_property
    def rotation_parts(self) -> tuple[Array, Array, Array]:
        """(F, C, S) with R0 Rot(axis, q) = F + cos(q) C + sin(q) S.

        With F = R0 a a^T, constant entries do not contain 1 - cos(q).
        """
        a, R0 = self.axis, self.placement.R
        fixed = outer(a, a)
        return R0 @ fixed, R0 @ (np.eye(3) - fixed), R0 @ skew(a)

    @frozen_property
    def parent_shift(self) -> Array:
        """(3,) translation of the link per unit of q, in the parent's axes."""
        return self.placement.R @ (self.travel * self.axis)


def _one_each(value: Any, count: int) -> list[Any]:
    """Return one value per degree of freedom from one value for all or a sequence."""
    return [value] * count if np.ndim(value) == 0 else list(value)
