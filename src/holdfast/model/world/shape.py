"""Shapes of the world as signed distances phi(x): positive outside, negative within the solid.

phi, its unit gradient n (out of the solid) and its Hessian S = dn/dx are about the shape's own axes. Near the surface
|grad phi| = 1, so that S n = 0, and a sphere of radius r whose centre is at c has the gap phi(c) - r.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

import numpy as np

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.spatial.frozen import ArrayField, Frozen, changed, making
from holdfast.spatial.pose import Pose, PoseField
from holdfast.spatial.scalar import Array, Scalar


class Distance(NamedTuple):
    """The signed distance of a point from a shape.

    Attributes:
        phi: the distance, negative within the solid [m].
        n: (3,) its gradient, a unit vector out of the solid.
        S: (3, 3) its Hessian [1/m].
    """

    phi: Scalar
    n: Array
    S: Array


@dataclass(frozen=True, eq=False, kw_only=True)
class WorldShape(Frozen, ABC):
    """A solid of the world; its surface may run along itself, like the belt of a conveyor.

    It stands, unless `simulate` has its motion in `base_motion`. `twist` and `acceleration` are for a single instant.

    Attributes:
        traceable: whether `distance` can be traced to machine code.
        friction: coefficient mu >= 0 of Coulomb's law between this shape and the object.
        restitution: coefficient of restitution, from 0 to 1, of impacts with the object.
        pose: frame in which the shape is described, in the world (Pose or wxyz_xyz).
        surface_twist: (6,) twist [omega; v] of the running surface relative to the shape, about the origin of `pose`,
            world axes; only the tangential part of its velocity counts. It turns with the shape [rad/s, m/s].
        twist: (6,) [omega; v] of the shape itself, about the origin of `pose`, world axes [rad/s, m/s].
        acceleration: (6,) its derivative [rad/s^2, m/s^2].
    """

    traceable: ClassVar[bool] = True

    friction: float = 0.0
    restitution: float = 0.0
    pose: PoseField = field(default_factory=making(Pose.identity))
    surface_twist: ArrayField = field(default_factory=making(np.zeros, 6))
    twist: ArrayField = field(default_factory=making(np.zeros, 6))
    acceleration: ArrayField = field(default_factory=making(np.zeros, 6))

    def __post_init__(self) -> None:
        put, what = object.__setattr__, self.what
        put(self, "friction", checks.number(self.friction, f"{what}: friction", at_least=0.0))
        given = checks.number(self.restitution, f"{what}: restitution", at_least=0.0)
        if isinstance(given, float) and given > 1.0:
            raise ModelError(f"{what}: restitution: expected a number from 0 to 1, got {given:g}")
        put(self, "restitution", given)
        put(self, "pose", checks.pose(self.pose, f"{what}: pose"))
        for name in ("surface_twist", "twist", "acceleration"):
            put(self, name, checks.numbers(getattr(self, name), (6,), f"{what}: {name}"))

    @property
    def what(self) -> str:
        """The name of the kind of shape in messages."""
        return type(self).__name__

    @abstractmethod
    def distance(self, x: Array) -> Distance:
        """Return the signed distance of a point x (3,), both in the shape's own axes. O(1)."""

    def moved(self, pose: Pose, twist: Array, acceleration: Array) -> WorldShape:
        """Return the shape at another pose, with its motion there; what runs along the surface turns with it."""
        turn, running = pose.R @ self.pose.R.T, self.surface_twist
        running = np.concatenate([turn @ running[:3], turn @ running[3:]]) if running.any() else running
        return changed(self, pose=pose, twist=twist, acceleration=acceleration, surface_twist=running)

    def from_world(self, x: Array) -> Distance:
        """Return the signed distance of a point x (3,), both in world axes. O(1)."""
        R = self.pose.R
        found = self.distance((x - self.pose.p) @ R)
        return Distance(found.phi, R @ found.n, R @ found.S @ R.T)
