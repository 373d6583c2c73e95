"""The surfaces and colours with which arms are drawn, one piece for each visual of a link."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from holdfast.model.closed_chain import ClosedChain
from holdfast.model.held_object import HeldObject
from holdfast.model.trunk import TRUNK
from holdfast.model.visuals import Box, Capsule, Cylinder, Sphere, Visual
from holdfast.model.visuals import Mesh as MeshFile
from holdfast.robots.mesh_files.mesh import FARTHEST_VERTEX, MeshFault, TriangleMesh, require_triangles
from holdfast.robots.mesh_files.read import read_mesh
from holdfast.robots.primitive import LINK_COLOURS, Primitive
from holdfast.spatial.frozen import FrozenDict
from holdfast.spatial.pose import Pose
from holdfast.view import meshes

UNCOLOURED = (0.78, 0.78, 0.8, 1.0)
SHRINK = 0.003


class LinkMesh(NamedTuple):
    """A rigid surface to draw.

    Attributes:
        mesh: the surface, in the axes of the body to which it is fixed.
        colour: red, green and blue, 0 to 255; None for the colour of the arm.
    """

    mesh: TriangleMesh
    colour: tuple[int, int, int] | None


class UrdfMeshes(NamedTuple):
    """The visuals of the base and the links of a URDF.

    Attributes:
        link_meshes: N + 1 lists of surfaces, base to tip; None if a mesh is missing, or there are no visuals.
        missing: names of the meshes that cannot be read, and the reasons.
    """

    link_meshes: list[list[LinkMesh]] | None
    missing: tuple[str, ...]


def meshes_of(visuals: Sequence[Sequence[Primitive]]) -> list[list[LinkMesh]]:
    """Return the surfaces of a base and of each link, as one list for each list of solids."""
    return [
        # coinciding surfaces of solids would flicker, so all sizes differ
        [_of_primitive(solid, 1.0 - SHRINK * ((2 * k + 3 * j) % 7)) for j, solid in enumerate(solids)]
        for k, solids in enumerate(visuals)
    ]


def meshes_of_urdf(
    visuals: Sequence[Sequence[Visual]], folder: Path | None, packages: Mapping[str, str] = FrozenDict()
) -> UrdfMeshes:
    """Return the visuals of the base and the links of a URDF; none if a mesh file cannot be read.

    Args:
        visuals: the result of `urdf_visuals`.
        folder: the folder to which file names are relative; None if there is no such folder.
        packages: folders of packages by name, which are searched first.
    """

    @cache
    def read(filename: str) -> TriangleMesh:
        return read_mesh(filename, folder, packages)

    found: list[list[LinkMesh]] = []
    missing: list[str] = []
    triangles = 0
    for link in visuals:
        found.append([])
        for visual in link:
            try:
                piece = piece_of(visual, read)
                triangles += len(piece.mesh.faces)
                require_triangles(triangles)
                found[-1].append(piece)
            except MeshFault as cause:
                missing.append(str(cause))
    return UrdfMeshes(None if missing or not any(found) else found, tuple(missing))


def meshes_in_files(chain: ClosedChain) -> tuple[dict[str, list[list[LinkMesh]]], dict[str, tuple[str, ...]]]:
    """Return the visuals in the files of arms and "trunk", and the reasons why meshes cannot be read; both by name.

    An arm without visuals is in neither. It is drawn with simple solids, like an arm whose meshes are missing.
    """
    link_meshes, missing = {}, {}
    for name, of in {**({} if chain.trunk is None else {TRUNK: chain.trunk}), **chain.arms}.items():
        if of.visuals is None:
            continue
        folder = Path(of.visuals.folder) if of.visuals.folder else None
        found = meshes_of_urdf(of.visuals.bodies, folder, of.visuals.packages)
        if found.link_meshes is not None:
            link_meshes[name] = found.link_meshes
        elif found.missing:
            missing[name] = found.missing
    return link_meshes, missing


def surface_of_object(held: HeldObject) -> TriangleMesh | MeshFault | None:
    """Return the surface of an object, or the reason why it cannot be read; None if the object has no shape."""
    if held.shape is None:
        return None
    try:
        visual = Visual("object", Pose.identity(), held.shape, None)
        surface = piece_of(visual, lambda name: read_mesh(name, Path(name).parent)).mesh
        require_triangles(len(surface.faces))
    except MeshFault as fault:
        return fault
    return surface


def notes_on(missing: Mapping[str, tuple[str, ...]], arms: Collection[str]) -> tuple[str, ...]:
    """Return a sentence for each arm, object or "trunk" with unreadable meshes, which names the first of them."""
    found = []
    for name, (first, *others) in missing.items():
        what = f"arm '{name}'" if name in arms else name
        more = f", and {len(others)} more" if others else ""
        found.append(f"{what} is drawn with simple solids: {first}{more}")
    return tuple(found)


def _of_primitive(solid: Primitive, scale: float) -> LinkMesh:
    lengths = [scale * length for length in solid.size]
    make = {"cylinder": meshes.cylinder, "capsule": meshes.capsule, "sphere": meshes.sphere}
    mesh = meshes.box(np.array(lengths)) if solid.kind == "box" else make[solid.kind](*lengths)
    return LinkMesh(mesh.at(solid.pose), None if solid.colour == "accent" else LINK_COLOURS[solid.colour])


def piece_of(visual: Visual, read: Callable[[str], TriangleMesh]) -> LinkMesh:
    """Return the surface and colour of a visual; `read` returns the surface in a file of a given name."""
    shape = visual.shape
    match shape:
        case Box():
            mesh = meshes.box(shape.size)
        case Cylinder():
            mesh = meshes.cylinder(shape.radius, shape.length)
        case Capsule():
            mesh = meshes.capsule(shape.radius, shape.length)
        case Sphere():
            mesh = meshes.sphere(shape.radius)
        case MeshFile():
            mesh = _from_file(shape, read)
    red, green, blue, _ = (round(255 * min(max(channel, 0.0), 1.0)) for channel in visual.rgba or UNCOLOURED)
    return LinkMesh(mesh.at(visual.pose), (red, green, blue))


def _from_file(shape: MeshFile, read: Callable[[str], TriangleMesh]) -> TriangleMesh:
    """Return the surface in a mesh file, scaled."""
    found = read(shape.filename)
    mirrored = np.prod(np.sign(shape.scale)) < 0
    with np.errstate(all="ignore"):
        vertices = found.vertices * shape.scale
    if not (np.abs(vertices) <= FARTHEST_VERTEX).all():
        raise MeshFault(f"{shape.filename}: scale: expected vertices within {FARTHEST_VERTEX:g} m, got one beyond")
    return TriangleMesh(vertices, found.faces[:, ::-1] if mirrored else found.faces)
