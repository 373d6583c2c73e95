"""Finding and reading the mesh files that are named in a robot's file."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from holdfast.robots.mesh_files.collada import read_collada
from holdfast.robots.mesh_files.limits import LARGEST_FILE, MeshFault, require_plain
from holdfast.robots.mesh_files.mesh import Mesh
from holdfast.robots.mesh_files.obj import read_obj
from holdfast.robots.mesh_files.stl import read_stl

READERS = {".stl": read_stl, ".obj": read_obj, ".dae": read_collada}


def read_mesh(filename: str, folder: Path) -> Mesh:
    """Return the surface in a mesh file.

    Args:
        filename: name in the robot's file.
        folder: folder to which relative names refer.

    Raises:
        MeshFault: the file cannot be used; the message gives its path and the reason.
    """
    path = mesh_path(filename, folder)
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


MANIFEST = "package.xml"


def mesh_path(filename: str, folder: Path) -> Path:
    """Return the path of a mesh file.

    The package of a robot is the nearest folder, at or above that of its file, that contains a package.xml, or
    otherwise the parent of the file's folder. Relative names, absolute names and `file://` must refer to files in this
    package. `package://name/...` and `model://name/...` are searched at and above the robot's file: in its package, and
    in folders of that name that contain a package.xml.

    Args:
        filename: name in the robot's file.
        folder: folder of the robot's file.

    Raises:
        MeshFault: there is no such file, or it is outside the package.
    """
    shown = filename if len(filename) <= 200 and filename.isprintable() else ascii(filename[:200])
    scheme, separator, rest = filename.rpartition("://")
    folder = Path(os.path.abspath(folder))
    root = _package_of(folder)
    try:
        if not separator or scheme == "file":
            place = Path(os.path.normpath(folder / rest))
            if not place.is_relative_to(root):
                raise MeshFault(f"{shown}: expected a file in the robot's package, which is {root}")
            candidates = [place]
        elif scheme in ("package", "model"):
            candidates = _in_packages(rest, folder, root)
        else:
            raise MeshFault(f"{shown}: expected a file name, file://, package:// or model://")
        found = next((path for path in candidates if path.is_file()), None)
    except (OSError, ValueError) as cause:  # ValueError: a name that is not allowed in file systems
        raise MeshFault(f"{shown}: {getattr(cause, 'strerror', None) or cause}") from cause
    if found is None:
        raise MeshFault(f"{shown}: no such file")
    return found


def _package_of(folder: Path) -> Path:
    return next((above for above in (folder, *folder.parents) if (above / MANIFEST).is_file()), folder.parent)


def _in_packages(rest: str, folder: Path, root: Path) -> list[Path]:
    """Return the possible paths of `name/path` in packages."""
    name, _, path = rest.partition("/")
    if not name or ".." in rest.replace("\\", "/").split("/"):
        raise MeshFault(f"{rest[:200]!r}: expected the name of a package and a path in it, without '..'")
    places = []
    for above in (folder, *folder.parents):
        if above.is_relative_to(root) or (above / name).is_relative_to(root) or (above / name / MANIFEST).is_file():
            places.append(above / name / path)
        if above.is_relative_to(root):  # the folder of the package may have another name
            places.append(above / path)
    return [place for place in places if not os.path.isabs(path)]
