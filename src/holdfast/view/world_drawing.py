"""Shapes of the world, and the forces by which they touch the object, in the 3D scene."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from holdfast.dynamics.contact.rows import contact_rows
from holdfast.model.world.convex_mesh import ConvexMesh
from holdfast.model.world.features import Circle
from holdfast.model.world.height_field import HeightField
from holdfast.model.world.holes import Hole, Rod
from holdfast.model.world.shape import WorldShape
from holdfast.model.world.solids import Ball, Box, Cone, Cylinder, HalfSpace
from holdfast.model.world.touching import Touching
from holdfast.robots.mesh_files.mesh import TriangleMesh
from holdfast.spatial import rotation
from holdfast.spatial.pose import UP, Pose
from holdfast.spatial.scalar import Array
from holdfast.view import meshes
from holdfast.view.playback import Playback

PLATE_THICKNESS = 0.02  # relative to its width
RIM_LINES, EDGE_LINES = 48, 5

Placed = tuple[Pose, TriangleMesh]


def placed_mesh(shape: WorldShape, near: Array, size: float) -> Placed | None:
    """Return a mesh of a shape, and the pose of its frame in the world; None for a shape of another kind.

    Args:
        shape: the shape.
        near: (3,) point in the world near which an endless shape is drawn [m].
        size: length up to which it is drawn [m].
    """
    of_kind = _MESHES.get(type(shape))
    return None if of_kind is None else of_kind(shape, shape.pose.inverse() @ Pose(np.eye(3), near), size)


def solids_of(touching: Touching | None, size: float) -> list[TriangleMesh]:
    """Return the meshes of the solids with which an object touches the world, in object axes [m].

    Args:
        touching: what may touch.
        size: length up to which endless solids are drawn [m].
    """
    solids = () if touching is None else touching.solids.values()
    placed = [placed_mesh(shape, np.zeros(3), size) for shape in solids]
    return [mesh.at(pose) for pose, mesh in (one for one in placed if one is not None)]


def touching_points(playback: Playback, k: int) -> Array:
    """Return where the object would touch every shape in a frame, (pairs, 3) world axes [m]: c - r n."""
    held = Pose.from_wxyz_xyz(playback.object_pose[k])
    return held.p + contact_rows(playback.touching[k], held, np.zeros(6)).point


def circle_lines(circle: Circle) -> Array:
    """Return the lines (N, 2, 3) of a circle, in the axes of its body [m]."""
    points = np.array([circle.at(angle).arm for angle in np.linspace(0.0, 2.0 * np.pi, RIM_LINES + 1)])
    return np.stack([points[:-1], points[1:]], axis=1)


def _revolved(shape: Hole | Rod, first: tuple[float, float], last: tuple[float, float]) -> TriangleMesh:
    """Return the surface of a rounded profile between two more points of it."""
    points = [first]
    for before, after in pairwise(shape.sides):
        begin, end = (np.arctan2(side.normal[1], side.normal[0]) for side in (before, after))
        angles = np.linspace(begin, end + 2.0 * np.pi * (end < begin - 1e-9), EDGE_LINES)
        r, z = after.foot
        points += [(float(r + shape.edge * np.cos(x)), float(z + shape.edge * np.sin(x))) for x in angles]
    return meshes.revolved([*points, last])


def _hole(shape: Hole, near: Pose, size: float) -> Placed:
    del near
    wide = shape.radius + shape.chamfer + 0.5 * size
    return shape.pose, _revolved(shape, (wide, 0.0), (shape.radius, -0.5 * size))


def _rod(shape: Rod, near: Pose, size: float) -> Placed:
    del near, size
    h = shape.half_length
    return shape.pose, _revolved(shape, (0.0, -h), (0.0, h))


def _height_field(shape: HeightField, near: Pose, size: float) -> Placed:
    del near, size
    fine = [np.linspace(0.0, (count - 1) * shape.spacing, 4 * (count - 1) + 1) for count in shape.heights.shape]
    columns = len(fine[1])
    vertices = np.array([(a, b, shape.surface(a, b)[0]) for a in fine[0] for b in fine[1]])
    corner = np.array([i * columns + j for i in range(len(fine[0]) - 1) for j in range(columns - 1)])
    faces = [np.stack([corner + a, corner + b, corner + c], axis=1) for a, b, c in _halves(columns)]
    return shape.pose, TriangleMesh(vertices, np.concatenate(faces))


def _halves(columns: int) -> list[tuple[int, int, int]]:
    """Return the corners of the two triangles of a cell, relative to its first."""
    return [(0, columns, columns + 1), (0, columns + 1, 1)]


def _convex_mesh(shape: ConvexMesh, near: Pose, size: float) -> Placed:
    del near, size
    return shape.pose, TriangleMesh(*shape.hull)


def _half_space(shape: HalfSpace, near: Pose, size: float) -> Placed:
    at = near.p - (shape.normal @ near.p - shape.offset) * shape.normal
    thick = PLATE_THICKNESS * size
    turn = rotation.exp(rotation.align(UP, shape.normal))
    return shape.pose @ Pose(turn, at - 0.5 * thick * shape.normal), meshes.box((size, size, thick))


def _ball(shape: Ball, near: Pose, size: float) -> Placed:
    return shape.pose, meshes.sphere(shape.radius)


def _cylinder(shape: Cylinder, near: Pose, size: float) -> Placed:
    z = float(near.p[2])
    return shape.pose, meshes.revolved([(shape.radius, z - 0.5 * size), (shape.radius, z + 0.5 * size)], smooth=True)


def _cone(shape: Cone, near: Pose, size: float) -> Placed:
    return shape.pose, meshes.revolved([(0.0, 0.0), (0.5 * size * np.tan(shape.angle), 0.5 * size)], smooth=True)


def _box(shape: Box, near: Pose, size: float) -> Placed:
    return shape.pose, meshes.box(2.0 * shape.half)


_MESHES: dict[type[WorldShape], Callable[..., Placed]] = {
    HalfSpace: _half_space,
    Ball: _ball,
    Cylinder: _cylinder,
    Cone: _cone,
    Box: _box,
    Hole: _hole,
    Rod: _rod,
    HeightField: _height_field,
    ConvexMesh: _convex_mesh,
}
