"""Shapes of the world, and the forces by which they touch the object, in the 3D scene."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from holdfast.model.world.shape import WorldShape
from holdfast.model.world.solids import Ball, Box, Cone, Cylinder, HalfSpace
from holdfast.robots.mesh_files.mesh import TriangleMesh
from holdfast.spatial import rotation
from holdfast.spatial.pose import UP, Pose
from holdfast.spatial.scalar import Array
from holdfast.view import meshes
from holdfast.view.playback import Playback

PLATE_THICKNESS = 0.02  # relative to its width

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


def touching_points(playback: Playback, k: int) -> Array:
    """Return where the object would touch every shape in a frame, (pairs, 3) world axes [m]: c - r n."""
    touching = playback.chain.touching
    assert touching is not None
    held, points = Pose.from_wxyz_xyz(playback.object_pose[k]), []
    for one in touching.candidates:
        centre = held.p + held.R @ one.sphere.centre
        points.append(centre - one.sphere.radius * one.shape.from_world(centre).n)
    return np.array(points)


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
}
