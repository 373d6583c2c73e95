"""The reader of Wavefront OBJ files, which uses vertices and faces and ignores everything else."""

from __future__ import annotations

from array import array
from itertools import pairwise

import numpy as np

from holdfast.robots.mesh_files.limits import MOST_TRIANGLES, MOST_VERTICES, MeshFault, require_triangles
from holdfast.spatial.scalar import Array

LONGEST_LINE = 100_000  # characters


def read_obj(content: bytes) -> tuple[Array, Array]:
    """Return vertices (V, 3) and faces (F, 3); polygons are split into fans.

    Raises:
        MeshFault: the file is invalid; the message gives the line.
    """
    _require_vertices(content.count(b"\nv "))
    require_triangles(max(content.count(b"\nf "), 1))  # each face is at least one triangle
    points, triangles = array("d"), array("q")
    line, begin = 0, 0
    while begin < len(content):  # line by line, without a list of all lines
        end = content.find(b"\n", begin)
        end = len(content) if end < 0 else end
        if end - begin > LONGEST_LINE:
            raise MeshFault(f"line {line + 1}: expected at most {LONGEST_LINE:,} characters, got more")
        words, begin, line = content[begin:end].split(), end + 1, line + 1
        try:
            if words[:1] == [b"v"]:
                _require_three(words)
                points.extend(map(float, words[1:4]))
            elif words[:1] == [b"f"]:
                _require_three(words)
                corners = [_vertex(word, len(points) // 3) for word in words[1:]]
                for second, third in pairwise(corners[1:]):
                    triangles.extend((corners[0], second, third))
        except (ValueError, OverflowError) as cause:
            raise MeshFault(f"line {line}: expected a vertex or a face, got others") from cause
        _require_vertices(len(points) // 3)
        if len(triangles) > 3 * MOST_TRIANGLES:
            require_triangles(len(triangles) // 3)
    return np.array(points).reshape(-1, 3), np.array(triangles).reshape(-1, 3)


def _require_vertices(count: int) -> None:
    if count > MOST_VERTICES:
        raise MeshFault(f"expected at most {MOST_VERTICES:,} vertices, got {count:,}")


def _require_three(words: list[bytes]) -> None:
    if len(words) < 4:
        raise ValueError("fewer than three")


def _vertex(word: bytes, known: int) -> int:
    """Return the index, from 0, of the vertex of a corner such as `7/2/5`; `-1` refers to the last vertex so far."""
    number = int(word.split(b"/", 1)[0])
    index = number - 1 if number > 0 else known + number
    if not number or not 0 <= index < 2**62:
        raise ValueError("no such vertex")
    return index
