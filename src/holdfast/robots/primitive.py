"""Simple solids for drawing links, as plain data for any viewer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal, get_args

import numpy as np

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.spatial import rotation
from holdfast.spatial.frozen import Frozen, FrozenDict
from holdfast.spatial.pose import UP, Pose
from holdfast.spatial.scalar import Array

PrimitiveKind = Literal["capsule", "cylinder", "box", "sphere"]
SIZE_COUNTS: Mapping[str, int] = FrozenDict({"capsule": 2, "cylinder": 2, "box": 3, "sphere": 1})
LINK_COLOURS: Mapping[str, tuple[int, int, int]] = FrozenDict(
    {
        "white": (236, 236, 232),
        "grey": (150, 154, 158),
        "dark": (58, 62, 68),
        "orange": (240, 130, 40),
        "blue": (128, 172, 204),
        "accent": (96, 150, 196),
    }
)


@dataclass(frozen=True, eq=False)
class Primitive(Frozen):
    """A solid fixed to a link.

    Attributes:
        kind: "capsule", "cylinder" (both along z), "box" or "sphere".
        pose: pose of its centre, in link axes.
        size: for a capsule or cylinder, radius and length (without the caps of a capsule); for a box, edge lengths
            along x, y, z; for a sphere, radius [m].
        colour: a name in `LINK_COLOURS`, which contains red, green and blue from 0 to 255. Viewers may replace
            "accent" by a colour specific to the arm.
    """

    kind: PrimitiveKind
    pose: Pose
    size: tuple[float, ...]
    colour: str = field(default="grey")

    def __post_init__(self) -> None:
        checks.instance(self.kind, str, "primitive: kind")
        checks.instance(self.colour, str, "primitive: colour")
        if self.kind not in get_args(PrimitiveKind):
            raise ModelError(
                f"primitive: kind: expected one of {', '.join(SIZE_COUNTS)}, got {checks.short(self.kind)}"
            )
        if self.colour not in LINK_COLOURS:
            raise ModelError(f"primitive: no colour '{self.colour}'.{checks.did_you_mean(self.colour, LINK_COLOURS)}")
        object.__setattr__(self, "pose", checks.pose(self.pose, "primitive: pose"))
        size = checks.numbers(self.size, (SIZE_COUNTS[self.kind],), f"primitive: size of a {self.kind}")
        if (size <= 0).any():
            raise ModelError(f"primitive: size: expected lengths > 0, got {self.size}")
        object.__setattr__(self, "size", tuple(size.tolist()))


def rod(kind: Literal["capsule", "cylinder"], start: Any, end: Any, radius: float, colour: str = "grey") -> Primitive:
    """Return a capsule or cylinder between two points of a link, (3,) each [m].

    Raises:
        ModelError: the two points are equal.
    """
    start, end = checks.numbers(start, (3,), "rod: start"), checks.numbers(end, (3,), "rod: end")
    axis = end - start
    length = float(np.sqrt(axis @ axis))
    if length == 0:
        raise ModelError(f"rod: expected two points, got {start} twice; try a sphere")
    pose = Pose(rotation.exp(rotation.align(UP, axis / length)), 0.5 * (start + end))
    return Primitive(kind, pose, (radius, length), colour)


capsule, cylinder = partial(rod, "capsule"), partial(rod, "cylinder")


def sphere(centre: Any, radius: float, colour: str = "grey") -> Primitive:
    """Return a sphere about a point of a link, (3,) [m]."""
    return Primitive("sphere", Pose(np.eye(3), checks.numbers(centre, (3,), "sphere: centre")), (radius,), colour)


def box(centre: Any, edges: tuple[float, float, float], colour: str = "grey", R: Array | None = None) -> Primitive:
    """Return a box about a point of a link, along its axes or those of R, (3, 3)."""
    pose = Pose(np.eye(3) if R is None else R, checks.numbers(centre, (3,), "box: centre"))
    return Primitive("box", pose, edges, colour)
