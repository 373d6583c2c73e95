"""The surfaces of a Collada <geometry>: arrays of points, and polygons that refer to them."""

from __future__ import annotations

from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np

from holdfast.spatial.scalar import Array
from holdfast.view.mesh_files.limits import MOST_TRIANGLES, MeshFault, numbers, require_triangles

MOST_OFFSET = 64  # numbers a corner has: of its vertex, normal, texture, ...


class Surface(NamedTuple):
    """Triangles.

    Attributes:
        vertices: (V, 3).
        faces: (F, 3).
    """

    vertices: Array
    faces: Array


def surfaces(geometry: Element) -> list[Surface]:
    """Return the surfaces of a geometry; none if it is lines, or a spline.

    Raises:
        MeshFault: what is wrong with it.
    """
    mesh = geometry.find("mesh")
    if mesh is None:
        return []
    by_id = {e.get("id", ""): e for e in mesh if e.tag in ("source", "vertices")}
    found, points = [], {}
    for part in mesh:
        if part.tag in ("tristrips", "trifans"):
            raise MeshFault(f"{part.tag}: expected triangles, polylist or polygons; try exporting it so")
        if part.tag in ("triangles", "polylist", "polygons"):
            offset, stride, url = _corner(part)
            if url not in points:
                points[url] = _points(by_id, url)
            faces = _faces(part, stride)[:, offset::stride] if len(part) else np.zeros((0, 3), dtype=int)
            if len(faces):
                found.append(_surface(points[url], faces))
    return found


def _surface(points: Array, faces: Array) -> Surface:
    """Return the faces with the points that they use alone: those may stand in many places."""
    if faces.min() < 0 or faces.max() >= len(points):
        raise MeshFault(f"expected faces of its {len(points)} vertices, got one of others")
    used, indices = np.unique(faces, return_inverse=True)
    return Surface(points[used], indices.reshape(-1, 3))


def _corner(part: Element) -> tuple[int, int, str]:
    """Return which of a corner's numbers is its vertex, how many a corner has, and where the vertices are."""
    vertex, most = None, 0
    for one in part.findall("input"):
        offset = _whole(one, "offset", 0, MOST_OFFSET)
        most = max(most, offset)
        if one.get("semantic") == "VERTEX":
            vertex = offset, one.get("source", "")
    if vertex is None:
        raise MeshFault(f"{part.tag}: expected an input VERTEX, got none")
    return vertex[0], most + 1, vertex[1]


def _points(by_id: dict[str, Element], url: str) -> Array:
    """Return the points (V, 3) that a VERTEX input refers to."""
    vertices = by_id.get(url.removeprefix("#"))
    inputs = [] if vertices is None else [one for one in vertices.findall("input") if one.get("semantic") == "POSITION"]
    source = by_id.get(inputs[0].get("source", "").removeprefix("#")) if inputs else None
    values = None if source is None else source.find("float_array")
    access = None if source is None else source.find("technique_common/accessor")
    if values is None or access is None:
        raise MeshFault(f"expected positions of '{url[:60]}', got none")
    found = numbers(values.text or "", float, "float_array")
    if _whole(values, "count", len(found), 2**40) != len(found):
        raise MeshFault(f"float_array: is cut off: expected {values.get('count', '')[:20]} numbers, got {len(found)}")
    stride, first = _whole(access, "stride", 3, 64), _whole(access, "offset", 0, 2**40)
    count = _whole(access, "count", 0, 2**40)
    if stride < 3 or first + count * stride > len(found):
        raise MeshFault(
            f"accessor: expected points of three numbers among {len(found)}, got {count} in steps of {stride}"
        )
    return found[first : first + count * stride].reshape(count, stride)[:, :3]


def _faces(part: Element, stride: int) -> Array:
    """Return the numbers of each triangle's three corners, (F, 3 stride); a polygon becomes a fan."""
    lists = [numbers(p.text or "", int, "p") for p in part.findall("p")]
    count = _whole(part, "count", 0, 2**40)
    if part.tag == "polygons":
        sizes, flat = (
            np.array([len(one) // stride for one in lists], dtype=int),
            np.concatenate([*lists, []]).astype(int),
        )
    else:
        flat = lists[0] if lists else np.zeros(0, dtype=int)
        require_triangles(max(count, 1))
        counts = part.find("vcount")
        sizes = (
            np.full(count, 3) if part.tag == "triangles" else numbers(getattr(counts, "text", "") or "", int, "vcount")
        )
    if (
        len(sizes) != count
        or (sizes < 1).any()
        or (sizes > MOST_TRIANGLES).any()
        or int(sizes.sum()) * stride != len(flat)
    ):
        raise MeshFault(f"{part.tag}: is damaged: expected {count} polygons of {stride} numbers a corner, got others")
    triangles = np.maximum(sizes - 2, 0)  # fewer than three corners have no surface
    require_triangles(max(int(triangles.sum()), 1))
    first = np.repeat(np.cumsum(sizes) - sizes, triangles)
    step = np.arange(len(first)) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    corners = np.column_stack([first, first + step + 1, first + step + 2])
    return flat.reshape(-1, stride)[corners].reshape(len(corners), 3 * stride)


def _whole(element: Element, attribute: str, default: int, most: int) -> int:
    """Return a whole number from 0 to `most`, or the default where the attribute is missing."""
    stated = element.get(attribute)
    if stated is None:
        return default
    if not stated.strip().isdecimal() or len(stated) > 15 or int(stated) > most:
        raise MeshFault(f"{element.tag}: {attribute}: expected a whole number up to {most}, got '{stated[:20]}'")
    return int(stated)
