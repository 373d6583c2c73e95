"""The reader of STL files, binary and text, which consist of triangles with separate corners."""

from __future__ import annotations

import re

import numpy as np

from holdfast.robots.mesh_files.limits import MOST_TRIANGLES, MeshFault, numbers, require_triangles
from holdfast.robots.mesh_files.mesh import distinct
from holdfast.spatial.scalar import Array

_HEAD, _TRIANGLE = 84, 50  # [bytes]
_CORNERS = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")])


def read_stl(content: bytes) -> tuple[Array, Array]:
    """Return vertices (V, 3) and faces (F, 3); corners at one point become one vertex.

    Raises:
        MeshFault: the file is invalid; the message says why.
    """
    count = int.from_bytes(content[_HEAD - 4 : _HEAD], "little")
    is_binary = len(content) == _HEAD + count * _TRIANGLE  # some binary files also begin with "solid"
    if not is_binary and content.lstrip()[:5].lower() == b"solid":
        corners = _of_text(content)
    else:
        corners = _of_bytes(content, count)
    vertices, which = distinct(corners.reshape(-1, 3).astype(float))
    return vertices, which.reshape(-1, 3)


def _of_bytes(content: bytes, count: int) -> Array:
    """Return the corners (F, 3, 3) of a binary file."""
    if len(content) < _HEAD:
        raise MeshFault(f"expected STL: a header of {_HEAD} bytes, got {len(content)}")
    require_triangles(count)
    if len(content) < _HEAD + count * _TRIANGLE:
        whole = (len(content) - _HEAD) // _TRIANGLE
        raise MeshFault(f"is cut off: expected {count:,} triangles as its header says, got {whole:,}")
    return np.frombuffer(content, _CORNERS, count, _HEAD)["corners"]


def _of_text(content: bytes) -> Array:
    """Return the corners (F, 3, 3) of a text file."""
    lower = content.lower()
    opened, closed, named = (lower.count(word) for word in (b"outer loop", b"endloop", b"vertex"))
    if opened > MOST_TRIANGLES or named > 3 * MOST_TRIANGLES:
        require_triangles(max(opened, named // 3))
    points = numbers(b" ".join(re.findall(rb"vertex[ \t]+([^\r\n]*)", lower)), float, "vertex")
    require_triangles(opened)
    if not 9 * opened == 9 * closed == 3 * named == len(points):
        raise MeshFault(f"is damaged: expected {opened} triangles of three vertices, got {len(points) / 9:g}")
    return points.reshape(-1, 3, 3)
