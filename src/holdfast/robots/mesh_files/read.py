"""Finding and reading the mesh files that are named in a robot's file: STL and OBJ here, Collada in `collada`."""

from __future__ import annotations

import os
import re
from array import array
from collections.abc import Mapping
from itertools import chain, pairwise
from pathlib import Path

import numpy as np

from holdfast.robots.mesh_files.collada import read_collada
from holdfast.robots.mesh_files.mesh import (
    LARGEST_MESH_FILE,
    MOST_TRIANGLES,
    MOST_VERTICES,
    MeshFault,
    TriangleMesh,
    distinct,
    numbers,
    require_plain,
    require_triangles,
)
from holdfast.robots.packages import PackageFolders
from holdfast.spatial.frozen import FrozenDict
from holdfast.spatial.scalar import Array

LONGEST_LINE = 100_000  # characters
_HEADER, _TRIANGLE = 84, 50  # [bytes]
_CORNERS = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")])


def read_mesh(filename: str, folder: Path | None, packages: Mapping[str, str] = FrozenDict()) -> TriangleMesh:
    """Return the surface in a mesh file.

    Args:
        filename: name in the robot's file.
        folder: folder to which relative names refer; None without one.
        packages: folders of packages by name, which are searched first.

    Raises:
        MeshFault: the file cannot be used; the message gives its path and the reason.
    """
    path = mesh_path(filename, PackageFolders(None if folder is None else Path(os.path.abspath(folder)), packages))
    read = READERS.get(path.suffix.lower())
    try:
        if read is None:
            raise MeshFault(f"expected a file of {', '.join(READERS)}")
        with path.open("rb") as file:
            content = file.read(LARGEST_MESH_FILE + 1)
        if len(content) > LARGEST_MESH_FILE:
            raise MeshFault(f"expected at most {LARGEST_MESH_FILE >> 20} MiB, got more")
        with np.errstate(all="ignore"):  # invalid numbers and overflows are refused below
            vertices, faces = read(content)
        require_plain(vertices, faces)
    except (OSError, MeshFault) as cause:
        raise MeshFault(f"{path}: cannot be read: {getattr(cause, 'strerror', None) or cause}") from cause
    return TriangleMesh(vertices, faces)


def mesh_path(filename: str, packages: PackageFolders) -> Path:
    """Return the path of a mesh file.

    Relative names, absolute names and `file://` must refer to files in the package of the robot's file, or in one that
    is given. `package://name/...` and `model://name/...` are files in a package that is found, or, since its folder may
    have another name, in that of the robot's file.

    Args:
        filename: name in the robot's file.
        packages: the packages that this file can refer to.

    Raises:
        MeshFault: there is no such file, or it is outside these packages.
    """
    shown = filename if len(filename) <= 200 and filename.isprintable() else ascii(filename[:200])
    scheme, separator, rest = filename.rpartition("://")
    try:
        if not separator or scheme == "file":
            return _in_own_packages(rest, shown, packages)
        if scheme in ("package", "model"):
            return _in_packages(rest, shown, packages)
    except (OSError, ValueError) as cause:  # ValueError: a name that is not allowed in file systems
        raise MeshFault(f"{shown}: {getattr(cause, 'strerror', None) or cause}") from cause
    raise MeshFault(f"{shown}: expected a file name, file://, package:// or model://")


def _in_own_packages(rest: str, shown: str, packages: PackageFolders) -> Path:
    """Return the path of a file in the robot's package, or in one that is given."""
    if packages.folder is None and not os.path.isabs(rest):
        raise MeshFault(f"{shown}: the robot came without a file whose folder it could be in")
    place = Path(os.path.normpath(os.path.join(packages.folder or "", rest)))
    own = [] if packages.own is None else [packages.own]
    if not any(place.is_relative_to(at) for at in (*own, *packages.given.values())):
        raise MeshFault(f"{shown}: expected a file in the robot's package, which is {packages.own}")
    if not place.is_file():
        raise MeshFault(f"{shown}: no such file")
    return place


def _in_packages(rest: str, shown: str, packages: PackageFolders) -> Path:
    """Return the path of `name/path` in a package."""
    name, _, path = rest.partition("/")
    if not name or ".." in rest.replace("\\", "/").split("/"):
        raise MeshFault(f"{rest[:200]!r}: expected the name of a package and a path in it, without '..'")
    places = chain(packages.places(name), packages.within)
    found = next((at / path for at in places if not os.path.isabs(path) and (at / path).is_file()), None)
    if found is None:
        where = packages.find(name)
        raise MeshFault(f"{shown}: no such file{f' in {where}' if where else f': {packages.not_found(name)}'}")
    return found


def read_stl(content: bytes) -> tuple[Array, Array]:
    """Return vertices (V, 3) and faces (F, 3); corners at one point become one vertex.

    Raises:
        MeshFault: the file is invalid; the message says why.
    """
    count = int.from_bytes(content[_HEADER - 4 : _HEADER], "little")
    is_binary = len(content) == _HEADER + count * _TRIANGLE  # some binary files also begin with "solid"
    if not is_binary and content.lstrip()[:5].lower() == b"solid":
        corners = _of_text(content)
    else:
        corners = _of_bytes(content, count)
    vertices, which = distinct(corners.reshape(-1, 3).astype(float))
    return vertices, which.reshape(-1, 3)


def _of_bytes(content: bytes, count: int) -> Array:
    """Return the corners (F, 3, 3) of a binary file."""
    if len(content) < _HEADER:
        raise MeshFault(f"expected STL: a header of {_HEADER} bytes, got {len(content)}")
    require_triangles(count)
    if len(content) < _HEADER + count * _TRIANGLE:
        whole = (len(content) - _HEADER) // _TRIANGLE
        raise MeshFault(f"is cut off: expected {count:,} triangles as its header says, got {whole:,}")
    return np.frombuffer(content, _CORNERS, count, _HEADER)["corners"]


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


READERS = {".stl": read_stl, ".obj": read_obj, ".dae": read_collada}
