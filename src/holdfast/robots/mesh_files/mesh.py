"""Triangle meshes, the limits of their size, and the error for those that cannot be used."""

from __future__ import annotations

import warnings
from typing import NamedTuple

import numpy as np

from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array

LARGEST_MESH_FILE = 64 * 2**20  # [bytes]
MOST_TRIANGLES = 2_000_000  # in one file, and in all files of an arm together
MOST_VERTICES = 3 * MOST_TRIANGLES
FARTHEST_VERTEX = 1e6  # [m, before scaling]; beyond it, the float32 numbers of the viewer cannot resolve millimetres


class TriangleMesh(NamedTuple):
    """A surface of triangles, which are counter-clockwise seen from outside.

    Attributes:
        vertices: (V, 3) [m]; the vertices of a sharp edge may be duplicated, so that shading is not smoothed across it.
        faces: (F, 3) indices of vertices.
    """

    vertices: Array
    faces: Array

    def at(self, pose: Pose) -> TriangleMesh:
        """Return the mesh transformed by the pose of its frame."""
        return TriangleMesh(self.vertices @ pose.R.T + pose.p, self.faces)


class MeshFault(Exception):
    """A mesh file cannot be used; the message says why, without the file's name."""


def require_triangles(count: int) -> None:
    """Check a number of triangles before memory is allocated for them.

    Raises:
        MeshFault: there are none, or too many.
    """
    if not count:
        raise MeshFault("has no surface")
    if not 0 < count <= MOST_TRIANGLES:
        raise MeshFault(f"expected at most {MOST_TRIANGLES:,} triangles, got {count:,}")


def numbers(text: str | bytes, kind: type[float] | type[int], what: str) -> Array:
    """Return the numbers in a text, separated by blanks, using memory of at most a few times its length.

    Raises:
        MeshFault: a word is not a number.
    """
    if not text.strip():
        return np.zeros(0, dtype=kind)
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # NumPy only warns about invalid text
        try:
            return np.fromstring(text, dtype=kind, sep=" ")  # pyright: ignore[reportArgumentType, reportCallIssue]
        except (ValueError, DeprecationWarning, OverflowError) as cause:
            raise MeshFault(f"{what}: expected numbers separated by blanks") from cause


def require_plain(vertices: Array, faces: Array) -> None:
    """Check that vertices are finite and not too far away, and that faces refer to existing vertices.

    Raises:
        MeshFault: they do not; the message says which.
    """
    require_triangles(len(faces))
    if not (np.abs(vertices) <= FARTHEST_VERTEX).all():  # false for NaN too
        raise MeshFault(f"expected vertices within {FARTHEST_VERTEX:g} m, got one beyond, or not a number")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise MeshFault(f"expected faces of its {len(vertices)} vertices, got one of others")


def distinct(points: Array) -> tuple[Array, Array]:
    """Return the distinct points among points (N, 3), and for each point its index in these, (N,)."""
    order = np.lexsort(points.T)  # several times faster than np.unique of rows
    is_new = np.ones(len(points), dtype=bool)
    is_new[1:] = (points[order[1:]] != points[order[:-1]]).any(axis=1)
    indices = np.empty(len(points), dtype=int)
    indices[order] = np.cumsum(is_new) - 1
    return points[order[is_new]], indices
