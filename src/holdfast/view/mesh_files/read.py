"""A mesh file by the name that a robot's file gives it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from holdfast.view.mesh_files.collada import read_collada
from holdfast.view.mesh_files.limits import LARGEST_FILE, MeshFault, require_plain
from holdfast.view.mesh_files.mesh_path import mesh_path
from holdfast.view.mesh_files.obj import read_obj
from holdfast.view.mesh_files.stl import read_stl
from holdfast.view.meshes import Mesh

READERS = {".stl": read_stl, ".obj": read_obj, ".dae": read_collada}


def read_mesh(filename: str, folder: Path) -> Mesh:
    """Return the surface in a mesh file.

    Args:
        filename: as the robot's file gives it.
        folder: that relative names start from.

    Raises:
        MeshFault: where it is and why it cannot be had.
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
        with np.errstate(all="ignore"):  # what is no number, or overflows, is refused just below
            vertices, faces = read(content)
        require_plain(vertices, faces)
    except OSError as cause:
        raise MeshFault(f"{path}: cannot be read: {cause.strerror or cause}") from cause
    except MeshFault as cause:
        raise MeshFault(f"{path}: cannot be read: {cause}") from cause
    return Mesh(vertices, faces)
