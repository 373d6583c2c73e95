"""The held object as what it is: a sphere, a cylinder, a surface from a file, or the box of its inertia."""

from __future__ import annotations

import numpy as np

from holdfast.model.held_object import HeldObject
from holdfast.model.visuals import Cylinder, Sphere
from holdfast.robots.mesh_files.mesh import MeshFault
from holdfast.robots.visuals import equivalent_box
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array
from holdfast.view import meshes
from holdfast.view.link_meshes import surface_of_object
from holdfast.view.markers import box_lines
from holdfast.view.meshes import Mesh

AROUND = 48  # lines of a circle


def drawn_object(held: HeldObject) -> tuple[Mesh, Array, Array, Pose]:
    """Return surface, outline (N, 2, 3), and edges (3,) and pose of the box around it, all in object axes [m].

    Where the file of a surface cannot be had, the object is the box of its inertia.
    """
    surface = surface_of_object(held)
    if surface is None or isinstance(surface, MeshFault):
        edges, box = equivalent_box(held)
        return meshes.box(edges).at(box), box_lines(edges) @ box.R.T + box.p, edges, box
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    return surface, outline(held), high - low, Pose(np.eye(3), 0.5 * (low + high))


def outline(held: HeldObject) -> Array:
    """Return lines that show how a shape turns: great circles, rims and sides; none on a surface from a file."""
    match held.shape:
        case Sphere(radius):
            return np.concatenate([_circle(radius, axis, 0.0) for axis in range(3)])
        case Cylinder(radius, length):
            rims = [_circle(radius, 2, z) for z in (-length / 2, length / 2)]
            starts = rims[0][:: AROUND // 4, 0]
            return np.concatenate([*rims, np.stack([starts, starts + np.array([0.0, 0.0, length])], axis=1)])
    return np.zeros((0, 2, 3))


def _circle(radius: float, axis: int, height: float) -> Array:
    """Return a circle about an axis, at a height along it, as lines (AROUND, 2, 3)."""
    angles = np.linspace(0.0, 2 * np.pi, AROUND + 1)
    points = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(AROUND + 1, height)])
    points = np.roll(points, axis + 1, axis=1)
    return np.stack([points[:-1], points[1:]], axis=1)
