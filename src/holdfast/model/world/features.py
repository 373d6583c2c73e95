"""What of a body may touch shapes of another one: points, spheres, and circles such as the rim of a peg."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

import numpy as np

from holdfast.model import checks
from holdfast.model.world.shape import WorldShape
from holdfast.names import called
from holdfast.spatial.frozen import REQUIRED, ArrayField, Frozen, frozen_property, making
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, cos, sin, where
from holdfast.spatial.vector import cross

CIRCLE_SAMPLES = 8  # of a circle, from the nearest of which Newton's method starts
CIRCLE_STEPS = 10


class Nearest(NamedTuple):
    """The point of a feature that is nearest to a shape.

    Attributes:
        arm: (3,) the point, or the centre of its sphere, in the axes of the feature's body [m].
        along: (3,) derivative of the point by its place on the feature, same axes; 0 if it has no other [m/rad].
        bend: (3,) second derivative [m/rad^2].
    """

    arm: Array
    along: Array
    bend: Array


@called
@dataclass(frozen=True, eq=False)
class Sphere(Frozen):
    """A sphere of the object that may touch the world; with radius 0 it is a point.

    Attributes:
        centre: (3,) from C, object axes [m].
        radius: >= 0 [m].
    """

    count: ClassVar[int] = 1
    wanders: ClassVar[bool] = False
    centre: ArrayField = field(default_factory=making(np.zeros, 3))
    radius: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", checks.numbers(self.centre, (3,), "touching: centre"))
        object.__setattr__(self, "radius", checks.number(self.radius, "touching: radius", at_least=0.0))

    @property
    def thickness(self) -> float:
        """The radius of what is round about the nearest point [m]."""
        return self.radius

    def nearest(self, shape: WorldShape, place: Pose, which: int) -> Nearest:
        """Return the centre; the arguments are those of `Circle.nearest`."""
        del shape, place, which
        return Nearest(self.centre, np.zeros(3), np.zeros(3))


@called
@dataclass(frozen=True, eq=False)
class Circle(Frozen):
    """A circle of the object that may touch the world: the rim of a peg, round by `thickness`.

    x(theta) = centre + radius (cos theta e1 + sin theta e2),  gap = phi(x) - thickness at d phi / d theta = 0

    Two places of a circle may touch a shape at once, so that it makes two contacts, "rim.a" and "rim.b": the nearest
    place, and the nearest one at least a quarter turn away from it. Both are found by Newton's method from the nearest
    of eight samples, so that of two minima closer than an eighth of a turn only one is seen. Flat on a plane, a circle
    touches all round, and two places do not keep it level: points beside it do.

    Attributes:
        centre: (3,) from C, object axes [m].
        axis: (3,) unit vector normal to its plane, object axes.
        radius: > 0 [m].
        thickness: radius of the edge about the circle, >= 0: with more than 0 it is a torus [m].
    """

    count: ClassVar[int] = 2
    wanders: ClassVar[bool] = True
    centre: ArrayField = REQUIRED
    axis: ArrayField = REQUIRED
    radius: float = REQUIRED
    thickness: float = 0.0

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "centre", checks.numbers(self.centre, (3,), "circle: centre"))
        put(self, "axis", checks.unit_vector(self.axis, "circle: axis"))
        put(self, "radius", checks.number(self.radius, "circle: radius", above=0.0))
        put(self, "thickness", checks.number(self.thickness, "circle: thickness", at_least=0.0))

    @frozen_property
    def plane(self) -> tuple[Array, Array]:
        """Two unit vectors (3,) e1 and e2 that span its plane, with e1 x e2 along the axis."""
        e1 = np.cross(np.eye(3)[np.argmin(np.abs(self.axis))], self.axis)
        e1 = e1 / np.linalg.norm(e1)
        return e1, np.cross(self.axis, e1)

    def at(self, theta: Scalar) -> Nearest:
        """Return the point at an angle [rad]."""
        e1, e2 = self.plane
        out = cos(theta) * e1 + sin(theta) * e2
        return Nearest(self.centre + self.radius * out, self.radius * cross(self.axis, out), -self.radius * out)

    def nearest(self, shape: WorldShape, place: Pose, which: int) -> Nearest:
        """Return a place of the circle that is nearest to a shape, by eight samples and ten Newton steps. O(1).

        Args:
            shape: the shape.
            place: the pose of the circle's body in the shape's own axes.
            which: 0 for the nearest place, 1 for the nearest one at least a quarter turn away.
        """
        angles = [2.0 * np.pi * i / CIRCLE_SAMPLES for i in range(CIRCLE_SAMPLES)]
        theta = self._least(shape, place, angles)
        if which:
            theta = self._least(shape, place, [theta + angle for angle in angles[2:-1]])
        below, above = theta - angles[1], theta + angles[1]
        for _ in range(CIRCLE_STEPS):  # Newton's method on the slope, by halves where it leaves what brackets the zero
            slope, curvature = self._slope(shape, place, theta)
            below, above = where(slope < 0.0, theta, below), where(slope < 0.0, above, theta)
            later = where(curvature > 0.0, theta - slope / where(curvature > 0.0, curvature, 1.0), below - 1.0)
            theta = where((later - below) * (above - later) >= 0.0, later, 0.5 * (below + above))
        return self.at(theta)

    def _least(self, shape: WorldShape, place: Pose, angles: list[Scalar]) -> Scalar:
        """Return that of some angles at which the distance is least."""
        found, best = angles[0], np.inf
        for angle in angles:
            phi = shape.distance(place.R @ self.at(angle).arm + place.p).phi
            less = phi < best
            found, best = where(less, angle, found), where(less, phi, best)
        return found

    def _slope(self, shape: WorldShape, place: Pose, theta: Scalar) -> tuple[Scalar, Scalar]:
        """Return the first and second derivative of the distance by the angle."""
        arm, along, bend = self.at(theta)
        _, n, S = shape.distance(place.R @ arm + place.p)
        t = place.R @ along
        return n @ t, t @ S @ t + n @ (place.R @ bend)
