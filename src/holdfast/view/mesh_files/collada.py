"""Collada (.dae): the triangles of the scene's nodes, where they stand, in metres.

As RViz and Gazebo read robots: lengths are in the file's unit, and its `up_axis` is passed over, since URDF says how
meshes are turned. Materials, textures, normals, lines and skins are passed over too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from xml.etree.ElementTree import Element

import numpy as np

from holdfast.spatial.scalar import Array
from holdfast.view.mesh_files.collada_document import parse_collada
from holdfast.view.mesh_files.collada_geometry import Surface, surfaces
from holdfast.view.mesh_files.limits import MeshFault, numbers, require_triangles

DEEPEST = 50  # nodes within nodes, instances included
MOST_NODES = 20_000


def read_collada(content: bytes) -> tuple[Array, Array]:
    """Return vertices (V, 3) and faces (F, 3).

    Raises:
        MeshFault: what is wrong with it.
    """
    root = parse_collada(content)
    vertices, faces, base, seen = [], [], 0, 0
    read: dict[str, list[Surface]] = {}
    by_id = {e.get("id", ""): e for e in root.iter() if e.tag in ("geometry", "node", "visual_scene")}
    for geometry, transform in _placed(_scene(root, by_id), by_id, np.diag([*3 * [_metres(root)], 1.0])):
        if geometry not in read:
            read[geometry] = surfaces(_target(by_id, geometry, "geometry"))
        for surface in read[geometry]:
            seen += len(surface.faces)  # before any is made: one surface may stand in many places
            require_triangles(max(seen, 1))
            turned = np.linalg.det(transform[:3, :3]) < 0  # a mirrored surface still faces outward
            faces.append((surface.faces[:, ::-1] if turned else surface.faces) + base)
            base += len(surface.vertices)
            vertices.append(surface.vertices @ transform[:3, :3].T + transform[:3, 3])
    require_triangles(seen)
    return np.concatenate(vertices), np.concatenate(faces)


def _scene(root: Element, by_id: dict[str, Element]) -> Element:
    """Return the visual scene that is to be shown; the first where the file does not say."""
    instance = root.find("scene/instance_visual_scene")
    if instance is not None:
        return _target(by_id, instance.get("url", ""), "visual_scene")
    scene = root.find("library_visual_scenes/visual_scene")
    if scene is None:
        raise MeshFault("expected a visual_scene, got none")
    return scene


def _target(by_id: dict[str, Element], url: str, tag: str) -> Element:
    """Return what `#name` refers to."""
    found = by_id.get(url.removeprefix("#"))
    if found is None or found.tag != tag or not url.startswith("#"):
        raise MeshFault(f"expected the url of a {tag} in the file, got '{url[:60]}'")
    return found


def _metres(root: Element) -> float:
    """Return the length of the file's unit [m]."""
    unit = root.find("asset/unit")
    (length,) = (1.0,) if unit is None else _values(unit.get("meter", "1"), 1, "unit")
    if not length > 0.0:
        raise MeshFault(f"unit: expected a length > 0, got {length:g}")
    return length


def _placed(scene: Element, by_id: dict[str, Element], outer: Array) -> Iterator[tuple[str, Array]]:
    """Yield the url of each geometry that stands in the scene, and its transform (4, 4)."""
    waiting, count = [(node, outer, 1) for node in reversed(scene.findall("node"))], 0
    while waiting:
        node, transform, depth = waiting.pop()
        count += 1
        if depth > DEEPEST or count > MOST_NODES:
            raise MeshFault(f"expected at most {MOST_NODES:,} nodes in {DEEPEST} levels, got more")
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
            raise MeshFault(f"expected at most {MOST_NODES:,} nodes in {DEEPEST} levels, got more")
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
        K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) / length
        s, c = math.sin(math.radians(degrees)), math.cos(math.radians(degrees))
        found[:3, :3] += s * K + (1.0 - c) * (K @ K)
    return found


def _values(text: str | None, count: int, what: str) -> Array:
    values = numbers((text or "")[:2000], float, what)
    if len(values) != count:
        raise MeshFault(f"{what}: expected {count} numbers, got {len(values)}")
    return values
