"""A surface of triangles."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array


class Mesh(NamedTuple):
    """A surface of triangles, which turn counter-clockwise seen from outside.

    Attributes:
        vertices: (V, 3) [m]; a sharp edge may have its vertices twice, so that shading stops there.
        faces: (F, 3) indices of vertices.
    """

    vertices: Array
    faces: Array

    def at(self, pose: Pose) -> Mesh:
        """Return the mesh moved from its own frame to where `pose` is."""
        return Mesh(self.vertices @ pose.R.T + pose.p, self.faces)


def distinct(points: Array) -> tuple[Array, Array]:
    """Return the places among points (N, 3) once each, and at which of them each point is, (N,)."""
    order = np.lexsort(points.T)  # several times faster than np.unique of rows
    is_new = np.ones(len(points), dtype=bool)
    is_new[1:] = (points[order[1:]] != points[order[:-1]]).any(axis=1)
    indices = np.empty(len(points), dtype=int)
    indices[order] = np.cumsum(is_new) - 1
    return points[order[is_new]], indices
