"""What of the object may touch which shapes of the world."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.world.shape import WorldShape
from holdfast.names import called
from holdfast.spatial.frozen import REQUIRED, ArrayField, Frozen, FrozenDict, frozen_property, making
from holdfast.spatial.scalar import Array


@called
@dataclass(frozen=True, eq=False)
class Sphere(Frozen):
    """A sphere of the object that may touch the world; with radius 0 it is a point.

    Attributes:
        centre: (3,) from C, object axes [m].
        radius: >= 0 [m].
    """

    centre: ArrayField = field(default_factory=making(np.zeros, 3))
    radius: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", checks.numbers(self.centre, (3,), "touching: centre"))
        object.__setattr__(self, "radius", checks.number(self.radius, "touching: radius", at_least=0.0))


class Candidate(NamedTuple):
    """A sphere of the object and a shape of the world that may touch.

    Attributes:
        name: "sphere/shape".
        sphere: the sphere.
        shape: the shape.
    """

    name: str
    sphere: Sphere
    shape: WorldShape


@called
@dataclass(frozen=True, eq=False)
class Touching(Frozen):
    """The points and spheres of the object that may touch the world, and the shapes that they may touch.

    Every point may touch every shape, unless `pairs` says which. What is not listed passes through: two boxes do not
    meet edge on edge.

    Attributes:
        points: by name, points (3,) or `Sphere`s fixed in the object, object axes; `corners` lists those of a box.
        world: shapes of the world by name.
        pairs: names (point, shape) of those that may touch, in this order; None for all.

    Raises:
        ModelError: there is no point or no shape, one is of another type, or a pair is unknown.
    """

    points: Mapping[str, Any] = REQUIRED
    world: Mapping[str, WorldShape] = REQUIRED
    pairs: Sequence[tuple[str, str]] | None = None

    def __post_init__(self) -> None:
        for what, given, example in (
            ("points", self.points, "{'tip': [0, 0, -0.1]}"),
            ("world", self.world, "{'table': HalfSpace(offset=0.4)}"),
        ):
            if not isinstance(given, Mapping) or not given:
                raise ModelError(
                    f"touching: {what}: expected at least one by name, for example {example}, got {checks.short(given)}"
                )
            for name in given:
                checks.name(name, f"touching: {what}: name {name!r}")
        for name, shape in self.world.items():
            if not isinstance(shape, WorldShape):
                raise ModelError(
                    f"touching: world: '{name}': expected a shape such as HalfSpace, got {type(shape).__name__};"
                    " holdfast.world lists them"
                )
        object.__setattr__(self, "points", FrozenDict({n: _sphere(n, x) for n, x in self.points.items()}))
        object.__setattr__(self, "world", FrozenDict(self.world))
        if self.pairs is not None:
            object.__setattr__(self, "pairs", tuple(self._known(pair) for pair in self.pairs))

    def _known(self, pair: Any) -> tuple[str, str]:
        """Return a pair whose names are known."""
        if isinstance(pair, str) or len(pair) != 2 or pair[0] not in self.points or pair[1] not in self.world:
            raise ModelError(
                f"touching: pairs: expected (point, shape), got {checks.short(pair)}; points are"
                f" {', '.join(self.points)}, shapes {', '.join(self.world)}"
            )
        return (pair[0], pair[1])

    @frozen_property
    def candidates(self) -> tuple[Candidate, ...]:
        """The pairs, or every point with every shape, the points first in order; contacts are numbered so."""
        pairs = product(self.points, self.world) if self.pairs is None else self.pairs
        return tuple(Candidate(f"{point}/{shape}", self.points[point], self.world[shape]) for point, shape in pairs)

    @frozen_property
    def names(self) -> tuple[str, ...]:
        """The names of the candidates, "point/shape"."""
        return tuple(candidate.name for candidate in self.candidates)

    def names_of(self, chosen: Array) -> tuple[str, ...]:
        """Return the names of some candidates, given by a mask (k,)."""
        return tuple(name for name, one in zip(self.names, chosen, strict=True) if one)


def corners(x: float, y: float, z: float) -> dict[str, ArrayLike]:
    """Return the eight corners of a box with C at its centre, by the signs of their coordinates, such as "+-+".

    Args:
        x: edge length along the object's x axis, > 0 [m].
        y: likewise along y.
        z: likewise along z.

    Raises:
        ModelError: an edge is not > 0.
    """
    half = [0.5 * checks.number(edge, f"corners: {name}", above=0.0) for name, edge in (("x", x), ("y", y), ("z", z))]
    signs = [(a, b, c) for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)]
    return {"".join("-+"[s > 0] for s in one): np.multiply(one, half) for one in signs}


def _sphere(name: str, given: Any) -> Sphere:
    """Return a sphere, or a point as one."""
    if isinstance(given, Sphere):
        return given
    return Sphere(checks.numbers(given, (3,), f"touching: points: '{name}'"))
