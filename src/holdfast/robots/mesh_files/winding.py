"""Whether a closed surface encloses every place at most once, so that no part of its volume counts twice."""

from __future__ import annotations

import numpy as np

from holdfast.robots.mesh_files.limits import MeshFault
from holdfast.spatial.scalar import Array

SPREAD = 8192  # lines that are spread evenly
OF_FACES = 16384  # lines through faces, at most
MOST_PAIRS = 10_000_000  # of a line and a face whose extents overlap
AT_ONCE = 1_000_000  # of them in memory
CLOSE, ROUNDING = 1e-6, 3e-7  # of extent and coordinates: crossings closer than this are contact, in float32 too
# a rotation whose axes are parallel to no edge or face of what is usually built
AXES = np.linalg.qr(np.array([[0.61, 0.37, 0.53], [-0.43, 0.71, 0.29], [0.31, -0.23, 0.83]]))[0]
WITHIN = np.array([[0.29, 0.33, 0.38], [0.998, 0.0011, 0.0009], [0.0009, 0.998, 0.0011], [0.0011, 0.0009, 0.998]])


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
    turned = (corners - middle) @ AXES
    low, high = turned.min(axis=(0, 1)), turned.max(axis=(0, 1))
    close = CLOSE * (high - low).max() + ROUNDING * np.abs(corners).max()
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
            place = middle + AXES @ np.array([*line[k], depth[k] + 0.5 * length[k]])
            raise MeshFault(problem.format(", ".join(f"{x:.4g}" for x in place)))


TWICE = (
    "encloses some places twice, such as ({}), so their mass would count twice: shells overlap, lie within others, or"
    " occur twice; try their union in the program that wrote it, or, where an inner shell bounds a cavity, reversing it"
)
INSIDE_OUT = (
    "is inside out in parts, such as around ({}), whose mass would be negative: expected faces counter-clockwise seen"
    " from outside; try reversing those of such shells"
)


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
