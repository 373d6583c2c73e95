"""Finding and reading the mesh files that are named in a robot's file."""

from __future__ import annotations

import os
from collections.abc import Mapping
from itertools import chain
from pathlib import Path

import numpy as np

from holdfast.robots.mesh_files.collada import read_collada
from holdfast.robots.mesh_files.limits import LARGEST_FILE, MeshFault, require_plain
from holdfast.robots.mesh_files.mesh import Mesh
from holdfast.robots.mesh_files.obj import read_obj
from holdfast.robots.mesh_files.stl import read_stl
from holdfast.robots.packages import Packages
from holdfast.spatial.frozen import FrozenDict

READERS = {".stl": read_stl, ".obj": read_obj, ".dae": read_collada}


def read_mesh(filename: str, folder: Path | None, packages: Mapping[str, str] = FrozenDict()) -> Mesh:
    """Return the surface in a mesh file.

    Args:
        filename: name in the robot's file.
        folder: folder to which relative names refer; None without one.
        packages: folders of packages by name, which are searched first.

    Raises:
        MeshFault: the file cannot be used; the message gives its path and the reason.
    """
    path = mesh_path(filename, Packages(None if folder is None else Path(os.path.abspath(folder)), packages))
    read = READERS.get(path.suffix.lower())
    try:
        if read is None:
            raise MeshFault(f"expected a file of {', '.join(READERS)}")
        with path.open("rb") as file:
            content = file.read(LARGEST_FILE + 1)
        if len(content) > LARGEST_FILE:
            raise MeshFault(f"expected at most {LARGEST_FILE >> 20} MiB, got more")
        with np.errstate(all="ignore"):  # invalid numbers and overflows are refused below
            vertices, faces = read(content)
        require_plain(vertices, faces)
    except (OSError, MeshFault) as cause:
        raise MeshFault(f"{path}: cannot be read: {getattr(cause, 'strerror', None) or cause}") from cause
    return Mesh(vertices, faces)


def mesh_path(filename: str, packages: Packages) -> Path:
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


def _in_own_packages(rest: str, shown: str, packages: Packages) -> Path:
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


def _in_packages(rest: str, shown: str, packages: Packages) -> Path:
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
