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
from holdfast.model.world.features import Circle, Sphere
from holdfast.model.world.holes import Hole
from holdfast.model.world.shape import WorldShape
from holdfast.model.world.solids import Cylinder
from holdfast.names import called
from holdfast.spatial.frozen import REQUIRED, Frozen, FrozenDict, changed, frozen_property, making
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array

LEAST_OF_A_RIM = 6  # so many points on a circle stand for it; fewer are the corners of a prism


TouchingFeature = Sphere | Circle


class Candidate(NamedTuple):
    """A feature and a shape that may touch, one on the object and one in the world.

    Attributes:
        name: "feature/shape"; of a circle's two places "feature.a/shape" and "feature.b/shape".
        feature: the feature.
        shape: the shape.
        reverse: whether the feature is in the world, and the shape on the object.
        which: the place of a circle, 0 or 1.
    """

    name: str
    feature: TouchingFeature
    shape: WorldShape
    reverse: bool = False
    which: int = 0


@called
@dataclass(frozen=True, eq=False)
class Touching(Frozen):
    """What of the object may touch the world, and what of the world it may touch.

    Every point may touch every shape, and every edge every solid, unless `pairs` says which. What is not listed passes
    through: two boxes do not meet edge on edge.

    Attributes:
        points: by name, points (3,), `Sphere`s and `Circle`s fixed in the object, object axes; `corners` lists those
            of a box.
        world: shapes of the world by name.
        pairs: names (point, shape) or (edge, solid) of those that may touch, in this order; None for all.
        solids: shapes of the object by name, their poses in the object's frame; friction and restitution are theirs.
        edges: by name, points, spheres and circles that stand in the world, world axes: a hole's edge that meets a peg.

    Raises:
        ModelError: there is nothing that may touch, one is of another type, a pair is unknown, or points on a circle
            stand for a rim that needs more of them.
    """

    points: Mapping[str, Any] = REQUIRED
    world: Mapping[str, WorldShape] = REQUIRED
    pairs: Sequence[tuple[str, str]] | None = None
    solids: Mapping[str, WorldShape] = field(default_factory=making(dict))
    edges: Mapping[str, Any] = field(default_factory=making(dict))

    def __post_init__(self) -> None:
        ends = ("points", "world") if not (self.solids and self.edges) else ("edges", "solids")
        for what in ends:
            given = getattr(self, what)
            if not isinstance(given, Mapping) or not given:
                raise ModelError(
                    f"touching: {what}: expected at least one by name, for example {EXAMPLE_OF[what]}, got"
                    f" {checks.short(given)}"
                )
        for what in EXAMPLE_OF:
            given = getattr(self, what)
            if not isinstance(given, Mapping):
                raise ModelError(
                    f"touching: {what}: expected a mapping by name, for example {EXAMPLE_OF[what]}, got"
                    f" {checks.short(given)}"
                )
            for name in given:
                checks.name(name, f"touching: {what}: name {name!r}")
        for what, example in (("world", "HalfSpace"), ("solids", "Rod")):
            for name, shape in getattr(self, what).items():
                if not isinstance(shape, WorldShape):
                    raise ModelError(
                        f"touching: {what}: '{name}': expected a shape such as {example}, got {type(shape).__name__};"
                        " holdfast.world lists them"
                    )
            object.__setattr__(self, what, FrozenDict(getattr(self, what)))
        for what in ("points", "edges"):
            made = {name: _feature(f"touching: {what}: '{name}'", x) for name, x in getattr(self, what).items()}
            object.__setattr__(self, what, FrozenDict(made))
        for names in ((self.points, self.edges), (self.world, self.solids)):
            if twice := [name for name in names[0] if name in names[1]]:
                raise ModelError(f"touching: expected every name once, got '{twice[0]}' on the object and in the world")
        for name, solid in self.solids.items():
            if solid.twist.any() or solid.acceleration.any() or solid.surface_twist.any():
                raise ModelError(f"touching: solids: '{name}': expected no motion of its own, as it is on the object")
        if self.pairs is not None:
            if not checks.is_listed(self.pairs):
                raise ModelError(f"touching: pairs: expected a list of (point, shape), got {checks.short(self.pairs)}")
            object.__setattr__(self, "pairs", tuple(self._known(pair) for pair in self.pairs))
            if not self.pairs:
                raise ModelError("touching: pairs: expected at least one, or None for all, got none")
        require_enough_points(self)

    def _known(self, pair: Any) -> tuple[str, str]:
        """Return a pair whose names are known."""
        if isinstance(pair, list | tuple) and len(pair) == 2 and all(isinstance(name, str) for name in pair):
            of_object, of_world = pair[0] in self.points, pair[0] in self.edges
            if (of_object and pair[1] in self.world) or (of_world and pair[1] in self.solids):
                return (pair[0], pair[1])
        reverse = f"; edges {', '.join(self.edges)}, solids {', '.join(self.solids)}" if self.edges else ""
        raise ModelError(
            f"touching: pairs: expected (point, shape), got {checks.short(pair)}; points are"
            f" {', '.join(self.points)}, shapes {', '.join(self.world)}{reverse}"
        )

    @frozen_property
    def candidates(self) -> tuple[Candidate, ...]:
        """The pairs, or every feature with every shape, the points first in order; contacts are numbered so."""
        pairs = self.pairs
        if pairs is None:
            pairs = [*product(self.points, self.world), *product(self.edges, self.solids)]
        return tuple(one for pair in pairs for one in self._candidates_of(*pair))

    def _candidates_of(self, of: str, shape: str) -> list[Candidate]:
        """Return one candidate, or the two of a circle."""
        reverse = of in self.edges
        feature = self.edges[of] if reverse else self.points[of]
        at = self.solids[shape] if reverse else self.world[shape]
        ends = [""] if feature.count == 1 else [".a", ".b"]
        return [Candidate(f"{of}{end}/{shape}", feature, at, reverse, which) for which, end in enumerate(ends)]

    @frozen_property
    def names(self) -> tuple[str, ...]:
        """The names of the candidates, "feature/shape"."""
        return tuple(candidate.name for candidate in self.candidates)

    def names_of(self, chosen: Array) -> tuple[str, ...]:
        """Return the names of some candidates, given by a mask (k,)."""
        return tuple(name for name, one in zip(self.names, chosen, strict=True) if one)

    def moved(self, motions: Mapping[str, tuple[Pose, Array, Array]]) -> Touching:
        """Return the same with shapes of the world at other poses, with their twists and accelerations there."""
        world = {name: x.moved(*motions[name]) if name in motions else x for name, x in self.world.items()}
        made = changed(self, world=FrozenDict(world))
        vars(made).pop("candidates", None)
        return made

    @frozen_property
    def without_machine_code(self) -> tuple[str, ...]:
        """The names of shapes that cannot be traced to machine code."""
        return tuple(name for name, x in {**self.world, **self.solids}.items() if not x.traceable)


EXAMPLE_OF = {
    "points": "{'tip': [0, 0, -0.1]}",
    "world": "{'table': HalfSpace(offset=0.4)}",
    "solids": "{'peg': Rod(radius=0.01, half_length=0.05)}",
    "edges": "{'edge': Circle([0, 0, 0], [0, 0, 1], 0.0101)}",
}


def require_enough_points(touching: Touching) -> None:
    """Refuse points on a circle in a hole whose clearance is below ten times what they leave of the circle.

    A circle of radius r passes r (1 - cos pi / m) outside the sides of a regular polygon of m points.

    Raises:
        ModelError: naming the hole.
    """
    for name, hole in touching.world.items():
        if not isinstance(hole, Cylinder | Hole) or not hole.inside:
            continue
        meeting = [one.feature for one in touching.candidates if one.shape is hole]
        m, points = len(meeting), [one.centre for one in meeting if isinstance(one, Sphere) and one.radius == 0.0]
        if len(points) != m or m < LEAST_OF_A_RIM:
            continue
        arms = np.array(points) - np.mean(points, axis=0)
        r = float(np.linalg.norm(arms, axis=1).mean())
        flat = np.linalg.svd(arms)[1][2] < 1e-6 * r
        if not flat or np.abs(np.linalg.norm(arms, axis=1) - r).max() > 1e-6 * r:
            continue
        left, clearance = r * (1.0 - np.cos(np.pi / m)), float(hole.radius) - r
        if clearance < 10.0 * left:
            raise ModelError(
                f"touching: '{name}': {m} points stand for a circle of radius {r:g} m to {left:.2g} m, expected a"
                f" tenth of the clearance of {clearance:.2g} m; try holdfast.world.Circle(centre, axis, radius)"
            )


@called
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


def _feature(what: str, given: Any) -> TouchingFeature:
    """Return a sphere or circle, or a point as a sphere."""
    return given if isinstance(given, Sphere | Circle) else Sphere(checks.numbers(given, (3,), what))
