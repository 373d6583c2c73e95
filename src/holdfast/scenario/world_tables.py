"""The shapes of the world in a scene, and what of the object may touch them: their tables and keys."""

from __future__ import annotations

from typing import Literal

import msgspec

from holdfast.scenario.table import KeyTable, PoseTable, Triple, Twist


class TouchingTable(KeyTable):
    """The points of the object that may touch the world, by name, or the corners of its box.

    With a `radius` they are spheres. Every point may touch every shape, unless `pairs` says which.
    """

    points: dict[str, Triple] | Literal["corners"]
    radius: float = 0.0
    pairs: list[tuple[str, str]] | None = None


class ShapeTable(KeyTable, kw_only=True):
    """A solid of the world at a pose; its surface may run along itself, with a twist about the pose's origin."""

    name: str
    pose: PoseTable = msgspec.field(default_factory=PoseTable)
    friction: float = 0.0
    restitution: float = 0.0
    surface_twist: Twist = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class HalfSpaceTable(ShapeTable, kw_only=True, tag_field="type", tag="half_space"):
    """A table, a floor or a wall: all points with normal . x <= offset."""

    normal: Triple = (0.0, 0.0, 1.0)
    offset: float = 0.0


class BallTable(ShapeTable, kw_only=True, tag_field="type", tag="sphere"):
    """A ball about the origin of its pose."""

    radius: float


class CylinderTable(ShapeTable, kw_only=True, tag_field="type", tag="cylinder"):
    """An endless cylinder about the z axis of its pose; with `inside`, a hole."""

    radius: float
    inside: bool = False


class ConeTable(ShapeTable, kw_only=True, tag_field="type", tag="cone"):
    """An endless cone that opens along the z axis of its pose; with `inside`, a funnel."""

    angle: float
    inside: bool = False


class RoundedBoxTable(ShapeTable, kw_only=True, tag_field="type", tag="box"):
    """A box about the origin of its pose, with rounded edges."""

    half: Triple
    edge: float = 1e-4


WorldTable = HalfSpaceTable | BallTable | CylinderTable | ConeTable | RoundedBoxTable
