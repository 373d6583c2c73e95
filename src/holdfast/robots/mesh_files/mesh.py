"""Triangle meshes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array


class Mesh(NamedTuple):
    """A surface of triangles, which are counter-clockwise seen from outside.

    Attributes:
        vertices: (V, 3) [m]; the vertices of a sharp edge may be duplicated, so that shading is not smoothed across it.
        faces: (F, 3) indices of vertices.
    """

    vertices: Array
    faces: Array

    def at(self, pose: Pose) -> Mesh:
        """Return the mesh transformed by the pose of its frame."""
        return Mesh(self.vertices @ pose.R.T + pose.p, self.faces)


def distinct(points: Array) -> tuple[Array, Array]:
    """Return the distinct points among points (N, 3), and for each point its index in these, (N,)."""
    order = np.lexsort(points.T)  # several times faster than np.unique of rows
    is_new = np.ones(len(points), dtype=bool)
    is_new[1:] = (points[order[1:]] != points[order[:-1]]).any(axis=1)
    indices = np.empty(len(points), dtype=int)
    indices[order] = np.cumsum(is_new) - 1
    return points[order[is_new]], indices
