"""Solids of revolution with a chamfer and round edges: a hole, and the rod or peg that goes into it.

Both are a convex profile in the half-plane (rho, z), rounded like a box: all points within `edge` of an inner polygon,

    phi = |d| - edge,  n = d / |d|,  S = (1_d - n n^T) / |d| + n_rho (1 - e e^T - z z^T) / rho,   x = rho e + z

with d from the nearest point of the inner polygon; 1_d is the plane (e, z) at a corner of it, and n n^T along a side.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.world.shape import Distance, WorldShape
from holdfast.model.world.solids import around, from_axis
from holdfast.names import called
from holdfast.spatial.frozen import REQUIRED, frozen_property
from holdfast.spatial.pose import UP
from holdfast.spatial.scalar import Array, Scalar, minimum, sqrt, where
from holdfast.spatial.vector import outer


class Side(NamedTuple):
    """A side of a convex profile: all points below it satisfy n . (x - foot) <= 0.

    Attributes:
        normal: (rho, z) unit vector out of the profile.
        foot: its first point; the next side begins at its end.
    """

    normal: tuple[float, float]
    foot: tuple[float, float]


def rounded(x: Array, sides: tuple[Side, ...], edge: float) -> Distance:
    """Return the distance from a solid of revolution whose profile has rounded edges.

    Args:
        x: (3,) the point, in axes whose z axis is that of revolution.
        sides: sides of the inner profile, in turn with the solid on the left; the first and the last are endless.
        edge: radius of the edges.
    """
    rho, e = from_axis(x)
    z = x[2]
    away = [a * (rho - r) + b * (z - h) for (a, b), (r, h) in sides]
    # deepest within, or on the side that is nearest: largest signed distance from the sides' lines
    phi: Scalar = away[0]
    n: tuple[Scalar, Scalar] = sides[0].normal
    for one, side in zip(away[1:], sides[1:], strict=True):
        more = one > phi
        phi, n = where(more, one, phi), (where(more, side.normal[0], n[0]), where(more, side.normal[1], n[1]))
    corner: Scalar = 0.0  # 1 / |d| at a corner, 0 along a side
    for before, after in pairwise(sides):
        dr, dz = rho - after.foot[0], z - after.foot[1]
        (a, b), (c, d) = before.normal, after.normal
        # past the end of the side before, along t = (-b, a), and before the start of the side after
        beyond = minimum(a * dz - b * dr, d * dr - c * dz) > 0.0
        square = dr * dr + dz * dz
        size = sqrt(where(square > 0.0, square, 1.0))
        phi = where(beyond, size, phi)
        n = where(beyond, dr / size, n[0]), where(beyond, dz / size, n[1])
        corner = where(beyond, 1.0 / size, corner)
    across = n[1] * e - n[0] * UP
    return Distance(phi - edge, n[0] * e + n[1] * UP, corner * outer(across, across) + (n[0] / rho) * around(e))


@called
@dataclass(frozen=True, eq=False, kw_only=True)
class Hole(WorldShape):
    """A round hole with a chamfer at its mouth, in a plate that fills z <= 0; it has no bottom.

    The wall is at rho = radius, the chamfer goes from z = -depth to radius + width at z = 0, where the plate's face
    begins. A bottom is a `HalfSpace` of its own.

    Attributes:
        radius: > 0 [m].
        chamfer: width of the chamfer, > 0 [m].
        depth: depth of the chamfer, > 0; None for the same as its width, 45 degrees [m].
        edge: radius of the two edges, > 0: a sharp edge has no normal [m].
        inside: True, as the object is inside.
    """

    radius: float = REQUIRED
    chamfer: float = REQUIRED
    depth: float | None = None
    edge: float = 1e-4

    def __post_init__(self) -> None:
        super().__post_init__()
        put, what = object.__setattr__, self.what
        for name in ("radius", "chamfer", "edge"):
            put(self, name, checks.number(getattr(self, name), f"{what}: {name}", above=0.0))
        depth = self.chamfer if self.depth is None else checks.number(self.depth, f"{what}: depth", above=0.0)
        put(self, "depth", depth)
        shortest = min(self.chamfer, depth)
        if not self.edge < shortest:
            raise ModelError(
                f"{what}: edge: expected a radius below the chamfer's width and depth, {shortest:g} m, got"
                f" {self.edge:g}; try a smaller edge"
            )

    @property
    def inside(self) -> bool:
        """True: the solid is all around the object."""
        return True

    @frozen_property
    def sides(self) -> tuple[Side, ...]:
        """The inner profile, from the plate's face down the wall."""
        w, h, e = self.chamfer, float(self.depth or 0.0), self.edge
        size = float(np.hypot(w, h))
        slope = (-h / size, w / size)
        top = (self.radius + w, 0.0)
        # the three lines, moved into the solid by `edge`: z = -e, the chamfer, rho = radius + e
        shift = slope[0] * top[0] + slope[1] * top[1] - e  # slope . x on the inner chamfer
        mouth = ((shift + slope[1] * e) / slope[0], -e)
        neck = (self.radius + e, (shift - slope[0] * (self.radius + e)) / slope[1])
        return Side((0.0, 1.0), mouth), Side(slope, mouth), Side((-1.0, 0.0), neck)

    def distance(self, x: Array) -> Distance:
        """Return phi, n, S at x (3,), in own axes."""
        return rounded(x, self.sides, self.edge)


@called
@dataclass(frozen=True, eq=False, kw_only=True)
class Rod(WorldShape):
    """A cylinder of finite length about the origin of `pose`, along its z axis, with round rims: a peg.

    Attributes:
        radius: > edge [m].
        half_length: > edge [m].
        edge: radius of its rims, > 0 [m].
    """

    radius: float = REQUIRED
    half_length: float = REQUIRED
    edge: float = 1e-4

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("radius", "half_length", "edge"):
            object.__setattr__(self, name, checks.number(getattr(self, name), f"{self.what}: {name}", above=0.0))
        if not min(self.radius, self.half_length) > self.edge:
            raise ModelError(
                f"{self.what}: edge: expected a radius below that of the rod and below half its length,"
                f" {min(self.radius, self.half_length):g} m, got {self.edge:g}; try a smaller edge"
            )

    @frozen_property
    def sides(self) -> tuple[Side, ...]:
        """The inner profile, from the lower end up."""
        r, h = self.radius - self.edge, self.half_length - self.edge
        return Side((0.0, -1.0), (0.0, -h)), Side((1.0, 0.0), (r, -h)), Side((0.0, 1.0), (r, h))

    def distance(self, x: Array) -> Distance:
        """Return phi, n, S at x (3,), in own axes."""
        return rounded(x, self.sides, self.edge)
