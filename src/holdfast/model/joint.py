"""One-degree-of-freedom joints."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.spatial.converted import ArrayField, Converted, making
from holdfast.spatial.frozen import Frozen, frozen_property
from holdfast.spatial.pose import Pose, PoseField
from holdfast.spatial.scalar import Array
from holdfast.spatial.vector import outer, skew

UNBOUNDED: Any = (-np.inf, np.inf)  # to a type checker no tuple is a `Converted`


@dataclass(frozen=True, eq=False)
class Joint(Frozen):
    """A joint between a link and its parent (the previous link, or the base).

    Revolute: R = R_parent R0 Rot(axis, q), p = p_parent + R_parent p0.
    Prismatic: R = R_parent R0, p = p_parent + R_parent (p0 + R0 axis q).

    Attributes:
        kind: "revolute" [rad] or "prismatic" [m].
        axis: (3,) unit vector in the axes of the link it moves.
        placement: pose of that link's frame at q = 0 in the parent frame (R0, p0).
        name: for messages.
        position_limits: lowest and highest q [rad or m].
        rate_limit: largest |qd| [rad/s or m/s].
        effort_limit: largest |tau| [N m or N].
        armature: inertia of the drive felt at the joint, >= 0 [kg m^2 or kg].
        damping: viscous damping, >= 0 [N m s/rad or N s/m].
        friction: Coulomb friction, >= 0 [N m or N]; used by simulation only.
    """

    kind: Literal["revolute", "prismatic"] = "revolute"
    axis: ArrayField = field(default_factory=making(np.array, [0.0, 0.0, 1.0]))
    placement: PoseField = field(default_factory=making(Pose.identity))
    name: str = ""
    position_limits: Converted[tuple[float, float], ArrayLike] = UNBOUNDED
    rate_limit: float = np.inf
    effort_limit: float = np.inf
    armature: float = 0.0
    damping: float = 0.0
    friction: float = 0.0

    def __post_init__(self) -> None:
        checks.instance(self.name, str, "joint: name")
        label = f"joint '{self.name}'" if self.name else "joint"
        if not isinstance(self.kind, str) or self.kind not in ("revolute", "prismatic"):
            raise ModelError(f"{label}: kind: expected 'revolute' or 'prismatic', got {checks.short(self.kind)}")
        put = object.__setattr__
        put(self, "axis", checks.unit_vector(self.axis, f"{label}: axis"))
        put(self, "placement", checks.pose(self.placement, f"{label}: placement"))
        for quantity in ("armature", "damping", "friction"):
            put(self, quantity, checks.number(getattr(self, quantity), f"{label}: {quantity}", at_least=0.0))
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

    @frozen_property
    def rotation_parts(self) -> tuple[Array, Array, Array]:
        """(F, C, S) with R0 Rot(axis, q) = F + cos(q) C + sin(q) S.

        F = R0 a a^T keeps entries that do not turn free of `1 - cos q`.
        """
        a, R0 = self.axis, self.placement.R
        fixed = outer(a, a)
        return R0 @ fixed, R0 @ (np.eye(3) - fixed), R0 @ skew(a)

    @frozen_property
    def parent_axis(self) -> Array:
        """(3,) the axis at q = 0 in the parent's axes."""
        return self.placement.R @ self.axis
