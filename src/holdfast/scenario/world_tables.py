"""The shapes of the world in a scene, and what of the object may touch them: their tables and keys."""

from __future__ import annotations

from typing import Literal

import msgspec

from holdfast.scenario.table import BaseMotionTable, KeyTable, NumberRows, PoseTable, Triple, Twist


class ShapeTable(KeyTable, kw_only=True):
    """A solid of the world at a pose; its surface may run along itself, with a twist about the pose's origin.

    With `base_motion` it moves about that pose, like the base of an arm.
    """

    name: str
    pose: PoseTable = msgspec.field(default_factory=PoseTable)
    friction: float = 0.0
    restitution: float = 0.0
    surface_twist: Twist = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    base_motion: BaseMotionTable | None = None


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


class HoleTable(ShapeTable, kw_only=True, tag_field="type", tag="hole"):
    """A hole with a chamfer, downwards from the plane z = 0 of its pose."""

    radius: float
    chamfer: float
    depth: float | None = None
    edge: float = 1e-4


class RodTable(ShapeTable, kw_only=True, tag_field="type", tag="rod"):
    """A cylinder of finite length about the origin of its pose, along z, with round rims."""

    radius: float
    half_length: float
    edge: float = 1e-4


class HeightFieldTable(ShapeTable, kw_only=True, tag_field="type", tag="height_field"):
    """A smooth surface through heights on a grid, whose first point is the origin of its pose."""

    heights: NumberRows
    spacing: float


WorldTable = (
    HalfSpaceTable | BallTable | CylinderTable | ConeTable | RoundedBoxTable | HoleTable | RodTable | HeightFieldTable
)


class CircleTable(KeyTable):
    """A circle, with a thickness that rounds it."""

    centre: Triple
    axis: Triple
    radius: float
    thickness: float = 0.0


class TouchingTable(KeyTable):
    """What of the object may touch the world: points by name or the corners of its box, circles, and solids.

    With a `radius` the points are spheres. `edges` are circles that stand in the world and may touch the solids. Every
    point and circle may touch every shape, unless `pairs` says which.
    """

    points: dict[str, Triple] | Literal["corners"] | None = None
    radius: float = 0.0
    pairs: list[tuple[str, str]] | None = None
    circles: dict[str, CircleTable] = {}
    solids: list[WorldTable] = []
    edges: dict[str, CircleTable] = {}
