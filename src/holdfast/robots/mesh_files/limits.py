"""Limits of the size of meshes, and the error for meshes that are too large, damaged or unavailable."""

from __future__ import annotations

import warnings

import numpy as np

from holdfast.spatial.scalar import Array

LARGEST_FILE = 64 * 2**20  # [bytes]
MOST_TRIANGLES = 2_000_000  # in one file, and in all files of an arm together
MOST_VERTICES = 3 * MOST_TRIANGLES
FARTHEST = 1e6  # [m, before scaling]; beyond it, the float32 numbers of the viewer cannot resolve millimetres


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
    if not (np.abs(vertices) <= FARTHEST).all():  # false for NaN too
        raise MeshFault(f"expected vertices within {FARTHEST:g} m, got one beyond, or not a number")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise MeshFault(f"expected faces of its {len(vertices)} vertices, got one of others")
