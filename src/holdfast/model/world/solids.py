"""Half-space, ball, cylinder, cone and box with rounded edges, by closed forms of + - * / sqrt and selection."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.world.shape import Distance, WorldShape
from holdfast.names import called
from holdfast.spatial.frozen import REQUIRED, ArrayField, making
from holdfast.spatial.pose import UP
from holdfast.spatial.scalar import Array, Scalar, array, maximum, select, sqrt, where
from holdfast.spatial.vector import outer


@called
@dataclass(frozen=True, eq=False, kw_only=True)
class HalfSpace(WorldShape):
    """The half-space n . x <= offset: a table, a floor, a wall.

    phi = n . x - offset,  S = 0

    Attributes:
        normal: (3,) unit vector out of the solid.
        offset: distance of the surface from the origin of `pose`, along the normal [m].
    """

    normal: ArrayField = field(default_factory=making(np.array, (0.0, 0.0, 1.0)))
    offset: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "normal", checks.unit_vector(self.normal, f"{self.what}: normal"))
        object.__setattr__(self, "offset", checks.number(self.offset, f"{self.what}: offset"))

    def distance(self, x: Array) -> Distance:
        """Return phi, n, S at x (3,), in own axes."""
        return Distance(self.normal @ x - self.offset, self.normal, np.zeros((3, 3)))


@called
@dataclass(frozen=True, eq=False, kw_only=True)
class Ball(WorldShape):
    """A solid ball about the origin of `pose`.

    phi = |x| - radius,  n = x / |x|,  S = (1 - n n^T) / |x|

    Attributes:
        radius: > 0 [m].
    """

    radius: float = REQUIRED

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "radius", checks.number(self.radius, f"{self.what}: radius", above=0.0))

    def distance(self, x: Array) -> Distance:
        """Return phi, n, S at x (3,), in own axes."""
        size, n = _length_and_direction(x)
        return Distance(size - self.radius, n, (np.eye(3) - outer(n, n)) / size)


@called
@dataclass(frozen=True, eq=False, kw_only=True)
class Cylinder(WorldShape):
    """An endless cylinder about the z axis of `pose`: a rod, or the wall of a hole.

    phi = +- (rho - radius),  n = +- e,  S = +- (1 - e e^T - z z^T) / rho      x = rho e + (z . x) z

    Attributes:
        radius: > 0 [m].
        inside: whether the object is inside: the solid is then all around, and the lower signs hold.
    """

    radius: float = REQUIRED
    inside: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "radius", checks.number(self.radius, f"{self.what}: radius", above=0.0))
        object.__setattr__(self, "inside", checks.flag(self.inside, f"{self.what}: inside"))

    def distance(self, x: Array) -> Distance:
        """Return phi, n, S at x (3,), in own axes."""
        rho, e = from_axis(x)
        sign = -1.0 if self.inside else 1.0
        return Distance(sign * (rho - self.radius), sign * e, (sign / rho) * around(e))


@called
@dataclass(frozen=True, eq=False, kw_only=True)
class Cone(WorldShape):
    """An endless cone that opens along the z axis of `pose`, its apex at the origin: a countersink or a centre point.

    phi = rho cos a - z sin a,  n = e cos a - z sin a,  S = cos a (1 - e e^T - z z^T) / rho

    where the nearest point is on the surface; outside and behind the apex, phi = |x|. Inside a funnel the signs change.

    Attributes:
        angle: half angle a between axis and surface, between 0 and pi / 2 [rad].
        inside: whether the object is inside: the cone is then a funnel in a solid that is all around.
    """

    angle: float = REQUIRED
    inside: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        angle = checks.number(self.angle, f"{self.what}: angle", above=0.0)
        if isinstance(angle, float) and angle >= 0.5 * np.pi:
            raise ModelError(f"{self.what}: angle: expected < pi / 2 (a half angle), got {angle:g}")
        object.__setattr__(self, "angle", angle)
        object.__setattr__(self, "inside", checks.flag(self.inside, f"{self.what}: inside"))

    def distance(self, x: Array) -> Distance:
        """Return phi, n, S at x (3,), in own axes."""
        c, s = float(np.cos(self.angle)), float(np.sin(self.angle))
        rho, e = from_axis(x)
        n = c * e - s * UP
        S = (c / rho) * around(e)
        phi = c * rho - s * x[2]
        if self.inside:
            return Distance(-phi, -n, -S)
        size, u = _length_and_direction(x)
        beyond = s * rho + c * x[2] < 0.0  # no point of the surface is nearer than the apex
        round_apex = (np.eye(3) - outer(u, u)) / size
        return Distance(where(beyond, size, phi), select(beyond, u, n), select(beyond, round_apex, S))


@called
@dataclass(frozen=True, eq=False, kw_only=True)
class Box(WorldShape):
    """A box about the origin of `pose` with rounded edges: all points within `edge` of an inner box.

    d = max(|x| - inner, 0),  phi = |d| - edge,  n = sign(x) d / |d|,  S = (1_d - n n^T) / |d|

    where 1_d has ones for the axes with d > 0. Within the inner box the nearest face counts.

    Attributes:
        half: (3,) half edge lengths, > edge [m].
        edge: radius of its edges and corners, > 0: a sharp edge has no normal [m].
    """

    half: ArrayField = REQUIRED
    edge: float = 1e-4

    def __post_init__(self) -> None:
        super().__post_init__()
        half = checks.numbers(self.half, (3,), f"{self.what}: half")
        edge = checks.number(self.edge, f"{self.what}: edge", above=0.0)
        if half.dtype != object and isinstance(edge, float) and not (half > edge).all():
            raise ModelError(
                f"{self.what}: half: expected half edge lengths above the radius of the edges, {edge:g} m, got"
                f" {checks.short(half.tolist())}; try a smaller edge"
            )
        object.__setattr__(self, "half", half)
        object.__setattr__(self, "edge", edge)

    def distance(self, x: Array) -> Distance:
        """Return phi, n, S at x (3,), in own axes."""
        sign = array([where(a < 0.0, -1.0, 1.0) for a in x.tolist()])
        depth = sign * x - (self.half - self.edge)
        out = maximum(depth, np.zeros(3))
        square = out @ out
        outside = square > 0.0
        size = sqrt(where(outside, square, 1.0))
        n = sign * out / size
        free = array([where(a > 0.0, 1.0, 0.0) for a in depth.tolist()])
        S = (np.diag(free) - outer(n, n)) / size
        most, axis = depth[0], np.eye(3)[0]
        for k in (1, 2):
            more = depth[k] > most
            most, axis = where(more, depth[k], most), select(more, np.eye(3)[k], axis)
        phi = where(outside, size, most) - self.edge
        return Distance(phi, select(outside, n, sign * axis), select(outside, S, np.zeros((3, 3))))


def _length_and_direction(x: Array) -> tuple[Scalar, Array]:
    """Return |x| and x / |x|; the z axis for x = 0, where there is no direction."""
    square = x @ x
    known = square > 0.0
    size = sqrt(where(known, square, 1.0))
    return where(known, size, 1e-300), select(known, x / size, UP)


def from_axis(x: Array) -> tuple[Scalar, Array]:
    """Return the distance rho from the z axis and the direction e away from it; the x axis on the axis itself."""
    square = x[0] * x[0] + x[1] * x[1]
    known = square > 0.0
    rho = sqrt(where(known, square, 1.0))
    e = array([where(known, x[0] / rho, 1.0), where(known, x[1] / rho, 0.0), 0.0])
    return where(known, rho, 1e-300), e


def around(e: Array) -> Array:
    """Return 1 - e e^T - z z^T, the projector on the direction around the z axis, for e across it."""
    t = array([-e[1], e[0], 0.0])
    return outer(t, t)
