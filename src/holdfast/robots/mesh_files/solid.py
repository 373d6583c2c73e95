"""The mass properties of the solid of uniform density inside a closed surface."""

from __future__ import annotations

import os
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import numpy as np

from holdfast.errors import ModelError, SceneError
from holdfast.model import checks
from holdfast.model.held_object import HeldObject
from holdfast.model.visuals import Mesh as MeshFile
from holdfast.robots.mesh_files.limits import MeshFault
from holdfast.robots.mesh_files.mesh import Mesh, distinct
from holdfast.robots.mesh_files.read import read_mesh
from holdfast.robots.mesh_files.winding import require_enclosed_once
from holdfast.robots.notes import show_notes
from holdfast.robots.visuals import equivalent_box
from holdfast.spatial.scalar import Array

LONGEST, HEAVIEST = 50.0, 1e6  # [m, kg]
THINNEST = 1e-12  # a surface that encloses less than this part of its extent's cube is flat


class Solid(NamedTuple):
    """Integrals over the volume inside a surface.

    Attributes:
        volume: volume [m^3].
        centre: (3,) centroid in the mesh's frame [m].
        inertia: (3, 3) inertia about the centroid for density 1 [m^5].
    """

    volume: float
    centre: Array
    inertia: Array


def held_object_from_mesh(
    path: str | PathLike[str], mass: float | None, density: float | None, scale: float
) -> HeldObject:
    """Return the object of a mesh file; see `HeldObject.from_mesh`.

    Raises:
        ModelError: both or neither of mass and density are given, or a number is not > 0.
        SceneError: the file cannot be read, or its surface does not enclose a solid.
    """
    if (mass is None) == (density is None):
        raise ModelError(f"from_mesh: expected one of mass and density, got {'neither' if mass is None else 'both'}")
    size = checks.number(scale, "from_mesh: scale", above=0.0)
    given = checks.number(density if mass is None else mass, "from_mesh: mass or density", above=0.0)
    checks.instance(path, (str, PathLike), "from_mesh: path")
    place = Path(os.path.abspath(path))
    try:
        found = solid(read_mesh(place.name, place.parent))
    except MeshFault as cause:
        text = str(cause)
        raise SceneError(text if str(place) in text else f"{place}: {text}") from cause
    volume = found.volume * size**3
    of_density = given if mass is None else given / volume
    inertia = of_density * size**5 * found.inertia
    made = HeldObject(of_density * volume, inertia, size * found.centre, shape=MeshFile(str(place), (size, size, size)))
    show_notes([f"{place}: {note}" for note in size_notes(made)])
    return made


def size_notes(held: HeldObject) -> list[str]:
    """Return a note on an object of a mesh file that is too large or heavy for any arm, with the likely cause."""
    edges = equivalent_box(held)[0]
    if edges.max() <= LONGEST and held.mass <= HEAVIEST:
        return []
    size = " x ".join(f"{edge:.3g}" for edge in edges)
    return [f"as large as a box of {size} m, {held.mass:.3g} kg: is the file in millimetres? Try scale=0.001"]


def solid(mesh: Mesh) -> Solid:
    """Return the volume, centroid and inertia of the solid inside a closed surface. O(F log F).

    By the divergence theorem the integrals are sums over the tetrahedra (O, a, b, c) of the faces,
        v = a . (b x c) / 6,   int x = v s / 4,   int x x^T = v (a a^T + b b^T + c c^T + s s^T) / 20,
    with s = a + b + c and any O; the last is computed about the centroid. This is right if every place is enclosed at
    most once, which is checked along lines.

    Raises:
        MeshFault: the surface is open, flat, or inside out, or encloses some places several times.
    """
    places, which = distinct(mesh.vertices)
    if gaps := _open_edges(which[mesh.faces], len(places)):
        raise MeshFault(
            f"is open: {gaps} edges have no matching neighbour in the opposite direction; expected a closed surface,"
            " all faces counter-clockwise seen from outside; try repairing it in the program that wrote it"
        )
    middle = 0.5 * (places.min(axis=0) + places.max(axis=0))
    extent = float((places.max(axis=0) - places.min(axis=0)).max())
    corners = mesh.vertices[mesh.faces] - middle
    parts = np.linalg.det(corners) / 6
    volume = float(parts.sum())
    if not abs(volume) > THINNEST * extent**3:
        raise MeshFault(f"encloses no volume: got {volume:.3g} m^3 in an extent of {extent:.3g} m")
    if volume < 0:
        raise MeshFault("is inside out: expected faces counter-clockwise seen from outside; try reversing them")
    require_enclosed_once(mesh.vertices[mesh.faces])
    centre = (parts[:, None] * corners.sum(axis=1)).sum(axis=0) / (4 * volume)
    corners = corners - centre
    four = [*np.moveaxis(corners, 1, 0), corners.sum(axis=1)]
    weights = np.linalg.det(corners) / 120
    S = np.array([[sum((weights * p[:, i] * p[:, j]).sum() for p in four) for j in range(3)] for i in range(3)])
    return Solid(volume, middle + centre, S.trace() * np.eye(3) - S)


def _open_edges(faces: Array, count: int) -> int:
    """Return the number of edges that do not occur equally often in both directions."""
    start, end = faces, np.roll(faces, -1, axis=1)
    edges = (np.minimum(start, end) * count + np.maximum(start, end)).ravel()
    _, which = np.unique(edges, return_inverse=True)
    return int(np.count_nonzero(np.bincount(which, np.sign(end - start).ravel())))
