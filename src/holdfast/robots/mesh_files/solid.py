"""The mass properties of the solid inside a closed surface, which may enclose every place at most once."""

from __future__ import annotations

import os
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import numpy as np

from holdfast.errors import ModelError, SceneError
from holdfast.model import checks
from holdfast.model.held_object import HeldObject
from holdfast.model.visuals import Mesh
from holdfast.robots.mesh_files.mesh import MeshFault, TriangleMesh, distinct
from holdfast.robots.mesh_files.read import read_mesh
from holdfast.robots.notes import show_notes
from holdfast.robots.visuals import equivalent_box
from holdfast.spatial.scalar import Array

LONGEST_SOLID, HEAVIEST_SOLID = 50.0, 1e6  # [m, kg]
THINNEST = 1e-12  # a surface that encloses less than this part of its extent's cube is flat
SPREAD = 8192  # lines that are spread evenly
OF_FACES = 16384  # lines through faces, at most
MOST_PAIRS = 10_000_000  # of a line and a face whose extents overlap
AT_ONCE = 1_000_000  # of them in memory
# parts of extent and of coordinates: crossings closer than this are contact, in float32 too
TOUCHING, TOUCHING_ROUNDING = 1e-6, 3e-7
# a rotation whose axes are parallel to no edge or face of what is usually built
OBLIQUE_AXES = np.linalg.qr(np.array([[0.61, 0.37, 0.53], [-0.43, 0.71, 0.29], [0.31, -0.23, 0.83]]))[0]
WITHIN = np.array([[0.29, 0.33, 0.38], [0.998, 0.0011, 0.0009], [0.0009, 0.998, 0.0011], [0.0011, 0.0009, 0.998]])
TWICE = (
    "encloses some places twice, such as ({}), so their mass would count twice: shells overlap, lie within others, or"
    " occur twice; try their union in the program that wrote it, or, where an inner shell bounds a cavity, reversing it"
)
INSIDE_OUT = (
    "is inside out in parts, such as around ({}), whose mass would be negative: expected faces counter-clockwise seen"
    " from outside; try reversing those of such shells"
)


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
    made = HeldObject(of_density * volume, inertia, size * found.centre, shape=Mesh(str(place), (size, size, size)))
    show_notes([f"{place}: {note}" for note in size_notes(made)])
    return made


def size_notes(held: HeldObject) -> list[str]:
    """Return a note on an object of a mesh file that is too large or heavy for any arm, with the likely cause."""
    edges = equivalent_box(held)[0]
    if edges.max() <= LONGEST_SOLID and held.mass <= HEAVIEST_SOLID:
        return []
    size = " x ".join(f"{edge:.3g}" for edge in edges)
    return [f"as large as a box of {size} m, {held.mass:.3g} kg: is the file in millimetres? Try scale=0.001"]


def solid(mesh: TriangleMesh) -> Solid:
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


def require_enclosed_once(corners: Array) -> None:
    """Check along lines that the winding number of a closed surface is 0 or 1 everywhere. O(F L) at worst.

    The lines are parallel, some spread evenly and some through the middle and near the corners of faces. On each, the
    winding number changes by 1 where the surface is crossed. Overlaps that no line passes through are not seen; their
    silhouette is less than about 1e-3 of the whole one.

    Args:
        corners: (F, 3, 3) corners of the faces, counter-clockwise seen from outside.

    Raises:
        MeshFault: some place is enclosed several times, or by a part that is inside out.
    """
    middle = 0.5 * (corners.min(axis=(0, 1)) + corners.max(axis=(0, 1)))
    turned = (corners - middle) @ OBLIQUE_AXES
    low, high = turned.min(axis=(0, 1)), turned.max(axis=(0, 1))
    close = TOUCHING * (high - low).max() + TOUCHING_ROUNDING * np.abs(corners).max()
    line, depth, step = _crossings(turned, _lines(turned, low, high))
    if not len(line):
        return
    order = np.lexsort((depth, line[:, 1], line[:, 0]))
    line, depth, step = line[order], depth[order], step[order]
    first = np.append(True, (line[1:] != line[:-1]).any(axis=1))
    which = np.cumsum(first) - 1
    number = np.cumsum(step)
    number -= (number - step)[first][which]
    closed = np.bincount(which, step)[which] == 0  # others meet an edge
    length = np.append(np.diff(depth), 0.0)
    apart = closed[:-1] & ~first[1:] & (length[:-1] > close)
    for wrong, problem in ((number < 0, INSIDE_OUT), (number > 1, TWICE)):
        if (found := np.flatnonzero(wrong[:-1] & apart)).size:
            k = found[np.argmax(length[found])]
            place = middle + OBLIQUE_AXES @ np.array([*line[k], depth[k] + 0.5 * length[k]])
            raise MeshFault(problem.format(", ".join(f"{x:.4g}" for x in place)))


def _lines(turned: Array, low: Array, high: Array) -> Array:
    """Return the places (L, 2) of lines in the plane across them, sorted by the first coordinate."""
    k = np.arange(1, SPREAD + 1)[:, None]
    spread = low[:2] + (high - low)[:2] * ((k * (0.7548776662466927, 0.5698402909980532)) % 1.0)  # an R2 sequence
    some = turned[:: max(1, -(-4 * len(turned) // OF_FACES)), :, :2]
    places = np.concatenate([spread, *(np.einsum("c,fcx->fx", weights, some) for weights in WITHIN)])
    widths = (turned[..., 0].max(axis=1) - turned[..., 0].min(axis=1)).sum() / (high[0] - low[0])
    fewer = places[:: max(1, int(widths * len(places) / MOST_PAIRS))]
    return fewer[np.argsort(fewer[:, 0], kind="stable")]


def _crossings(turned: Array, places: Array) -> tuple[Array, Array, Array]:
    """Return where lines cross faces: their places (C, 2), depths (C,) and changes of the winding number (C,)."""
    begin = np.searchsorted(places[:, 0], turned[..., 0].min(axis=1))
    counts = np.searchsorted(places[:, 0], turned[..., 0].max(axis=1)) - begin
    bottom, top = turned[..., 1].min(axis=1), turned[..., 1].max(axis=1)
    parts, ends, at = [], np.cumsum(counts), 0
    while at < len(counts):
        to = max(at + 1, int(np.searchsorted(ends, ends[at] - counts[at] + AT_ONCE, side="right")))
        number = counts[at:to]
        face = np.repeat(np.arange(at, to), number)
        offsets = np.arange(len(face)) - np.repeat(np.cumsum(number) - number, number)
        place = begin[face] + offsets
        near = (places[place, 1] > bottom[face]) & (places[place, 1] < top[face])
        parts.append(_crossed(turned[face[near]], places[place[near]]))
        at = to
    line, depth, step = (np.concatenate(each) for each in zip(*parts, strict=True))
    return line, depth, step


def _crossed(faces: Array, places: Array) -> tuple[Array, Array, Array]:
    """Return the crossings among pairs of a face and a line."""
    u, v = np.moveaxis(faces[..., :2] - places[:, None], -1, 0)
    areas = np.roll(u, -1, 1) * np.roll(v, -2, 1) - np.roll(v, -1, 1) * np.roll(u, -2, 1)
    leaves, enters = (areas > 0).all(axis=1), (areas < 0).all(axis=1)  # seen against the line, along it
    crossed = leaves | enters
    areas = areas[crossed]
    depth = (areas * faces[crossed, :, 2]).sum(axis=1) / areas.sum(axis=1)
    return places[crossed], depth, np.where(enters[crossed], 1, -1)
