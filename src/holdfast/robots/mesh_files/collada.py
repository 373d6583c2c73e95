"""The reader of Collada files (.dae), which returns the triangles of all nodes of the scene in metres.

Files are read as in RViz and Gazebo: lengths are in the unit of the file, and its `up_axis` is ignored, because the
URDF defines the orientation of meshes. Materials, textures, normals, lines and skins are ignored, too. A DOCTYPE is
refused, because it can define unbounded entities; the number and the depth of elements are bounded.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np

from holdfast.robots.mesh_files.mesh import MOST_TRIANGLES, MeshFault, TriangleMesh, numbers, require_triangles
from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array

DEEPEST_NODE, MOST_NODES = 50, 20_000  # levels of nested nodes, instances included; nodes in all
DEEPEST_COLLADA, MOST_COLLADA = 200, 200_000
MOST_OFFSET = 64  # numbers per corner: indices of its vertex, normal, texture, ...


def read_collada(content: bytes) -> tuple[Array, Array]:
    """Return vertices (V, 3) and faces (F, 3).

    Raises:
        MeshFault: the file is invalid; the message says why.
    """
    root = parse_collada(content)
    vertices, faces, base, seen = [], [], 0, 0
    read: dict[str, list[TriangleMesh]] = {}
    by_id = {e.get("id", ""): e for e in root.iter() if e.tag in ("geometry", "node", "visual_scene")}
    for geometry, transform in _placed(_scene(root, by_id), by_id, np.diag([*3 * [_metres(root)], 1.0])):
        if geometry not in read:
            read[geometry] = surfaces(_target(by_id, geometry, "geometry"))
        for surface in read[geometry]:
            seen += len(surface.faces)  # before any is created, because a surface may be used many times
            require_triangles(max(seen, 1))
            turned = np.linalg.det(transform[:3, :3]) < 0  # keeps the faces of a mirrored surface outward
            faces.append((surface.faces[:, ::-1] if turned else surface.faces) + base)
            base += len(surface.vertices)
            vertices.append(surface.vertices @ transform[:3, :3].T + transform[:3, 3])
    require_triangles(seen)
    return np.concatenate(vertices), np.concatenate(faces)


def _scene(root: Element, by_id: dict[str, Element]) -> Element:
    """Return the visual scene that the file selects, or the first one."""
    instance = root.find("scene/instance_visual_scene")
    if instance is not None:
        return _target(by_id, instance.get("url", ""), "visual_scene")
    scene = root.find("library_visual_scenes/visual_scene")
    if scene is None:
        raise MeshFault("expected a visual_scene, got none")
    return scene


def _target(by_id: dict[str, Element], url: str, tag: str) -> Element:
    """Return the element to which `#name` refers."""
    found = by_id.get(url.removeprefix("#"))
    if found is None or found.tag != tag or not url.startswith("#"):
        raise MeshFault(f"expected the url of a {tag} in the file, got '{url[:60]}'")
    return found


def _metres(root: Element) -> float:
    """Return the length of the file's unit [m], 1 by default."""
    unit = root.find("asset/unit")
    (length,) = (1.0,) if unit is None else _values(unit.get("meter", "1"), 1, "unit")
    if not length > 0.0:
        raise MeshFault(f"unit: expected a length > 0, got {length:g}")
    return length


def _placed(scene: Element, by_id: dict[str, Element], outer: Array) -> Iterator[tuple[str, Array]]:
    """Yield the url of each geometry in the scene, and its transform (4, 4)."""
    waiting, count = [(node, outer, 1) for node in reversed(scene.findall("node"))], 0
    while waiting:
        node, transform, depth = waiting.pop()
        count += 1
        if depth > DEEPEST_NODE or count > MOST_NODES:
            raise MeshFault(f"expected at most {MOST_NODES:,} nodes in {DEEPEST_NODE} levels, got more")
        within = []
        for part in node:
            match part.tag:
                case "matrix" | "translate" | "rotate" | "scale":
                    transform = transform @ _transform(part)
                case "lookat" | "skew":
                    raise MeshFault(f"node: expected matrix, translate, rotate and scale, got {part.tag}")
                case "instance_geometry":
                    yield part.get("url", ""), transform
                case "node":
                    within.append(part)
                case "instance_node":
                    within.append(_target(by_id, part.get("url", ""), "node"))
        if len(waiting) + len(within) > MOST_NODES:
            raise MeshFault(f"expected at most {MOST_NODES:,} nodes in {DEEPEST_NODE} levels, got more")
        waiting += [(one, transform, depth + 1) for one in reversed(within)]


def _transform(part: Element) -> Array:
    """Return the matrix (4, 4) of one transformation."""
    found = np.eye(4)
    if part.tag == "matrix":
        return _values(part.text, 16, "matrix").reshape(4, 4)
    if part.tag == "translate":
        found[:3, 3] = _values(part.text, 3, "translate")
    elif part.tag == "scale":
        found[:3, :3] = np.diag(_values(part.text, 3, "scale"))
    else:
        x, y, z, degrees = _values(part.text, 4, "rotate").tolist()
        length = math.hypot(x, y, z)
        if not 0.0 < length <= 1e9 or not abs(degrees) <= 1e9:
            raise MeshFault("rotate: expected an axis and an angle")
        found[:3, :3] = rotation.exp(math.radians(degrees) / length * np.array([x, y, z]))
    return found


def _values(text: str | None, count: int, what: str) -> Array:
    values = numbers((text or "")[:2000], float, what)
    if len(values) != count:
        raise MeshFault(f"{what}: expected {count} numbers, got {len(values)}")
    return values


def parse_collada(content: bytes) -> Element:
    """Return the root element, with tags without prefixes.

    Raises:
        MeshFault: not well-formed, not Collada, or beyond the bounds.
    """
    builder, parser = TreeBuilder(), expat.ParserCreate()
    depth = count = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, count
        depth, count = depth + 1, count + 1
        if depth > DEEPEST_COLLADA or count > MOST_COLLADA:
            raise MeshFault(f"expected at most {MOST_COLLADA:,} elements in {DEEPEST_COLLADA} levels, got more")
        builder.start(tag.rpartition(":")[2], attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag.rpartition(":")[2])

    def refuse(*_: object) -> None:
        raise MeshFault("expected no DOCTYPE, since it can define entities that grow without bound")

    parser.buffer_text = True
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.CharacterDataHandler, parser.StartDoctypeDeclHandler = builder.data, refuse
    try:
        parser.Parse(content, True)
        root = builder.close()
    except expat.ExpatError as fault:
        raise MeshFault(f"line {fault.lineno}: not well-formed XML: {expat.ErrorString(fault.code)}") from fault
    except (ValueError, LookupError, AssertionError) as fault:  # encodings that Python does not know
        raise MeshFault(f"cannot be decoded: {fault}") from fault
    if root.tag != "COLLADA":
        raise MeshFault(f"expected <COLLADA> as the outermost element, got <{root.tag[:40]}>")
    return root


def surfaces(geometry: Element) -> list[TriangleMesh]:
    """Return the surfaces of a geometry; empty for lines and splines.

    Raises:
        MeshFault: the file is invalid; the message says why.
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


def _surface(points: Array, faces: Array) -> TriangleMesh:
    """Return the faces with only the points that they use, because the surface may be used many times."""
    if faces.min() < 0 or faces.max() >= len(points):
        raise MeshFault(f"expected faces of its {len(points)} vertices, got one of others")
    used, indices = np.unique(faces, return_inverse=True)
    return TriangleMesh(points[used], indices.reshape(-1, 3))


def _corner(part: Element) -> tuple[int, int, str]:
    """Return the position of the vertex among a corner's numbers, their count, and the url of the vertices."""
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
    """Return the points (V, 3) to which a VERTEX input refers."""
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
    """Return the numbers of each triangle's three corners, (F, 3 stride); polygons are split into fans."""
    lists = [numbers(p.text or "", int, "p") for p in part.findall("p")]
    count = _whole(part, "count", 0, 2**40)
    if part.tag == "polygons":
        sizes = np.array([len(one) // stride for one in lists], dtype=int)
        flat = np.concatenate([*lists, []]).astype(int)
    else:
        require_triangles(max(count, 1))
        flat = lists[0] if lists else np.zeros(0, dtype=int)
        sizes = np.full(count, 3) if part.tag == "triangles" else numbers(part.findtext("vcount", ""), int, "vcount")
    possible = len(sizes) == count and (sizes >= 1).all() and (sizes <= MOST_TRIANGLES).all()
    if not possible or int(sizes.sum()) * stride != len(flat):
        raise MeshFault(f"{part.tag}: is damaged: expected {count} polygons of {stride} numbers a corner, got others")
    triangles = np.maximum(sizes - 2, 0)  # fewer than three corners have no surface
    require_triangles(max(int(triangles.sum()), 1))
    first = np.repeat(np.cumsum(sizes) - sizes, triangles)
    step = np.arange(len(first)) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    corners = np.column_stack([first, first + step + 1, first + step + 2])
    return flat.reshape(-1, stride)[corners].reshape(len(corners), 3 * stride)


def _whole(element: Element, attribute: str, default: int, most: int) -> int:
    """Return an integer from 0 to `most`; the default if the attribute is missing."""
    stated = element.get(attribute)
    if stated is None:
        return default
    if not stated.strip().isdecimal() or len(stated) > 15 or int(stated) > most:
        raise MeshFault(f"{element.tag}: {attribute}: expected a whole number up to {most}, got '{stated[:20]}'")
    return int(stated)
