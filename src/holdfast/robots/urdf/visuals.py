"""The visuals of links from the <visual> elements of a URDF file, for viewers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import holdfast.robots.urdf.attributes as attributes
from holdfast.errors import SceneError
from holdfast.model.visuals import Box, Capsule, Cylinder, Mesh, Rgba, Sphere, Visual, Visuals, VisualShape
from holdfast.robots.packages import PackageFolders
from holdfast.robots.urdf.document import Element
from holdfast.robots.urdf.robot import UrdfRobot
from holdfast.spatial.pose import Pose

if TYPE_CHECKING:
    from holdfast.robots.urdf.chain import UrdfChain
    from holdfast.robots.urdf.trunk import UrdfTrunkChain

Bodies = Sequence[Mapping[str, Pose]]


def urdf_visuals(chain: UrdfChain | UrdfTrunkChain) -> tuple[tuple[Visual, ...], ...]:
    """Return the visuals of the base and of each link of an arm, or of a trunk, N + 1 tuples. O(links).

    Poses are in the frame of the base or of arm link k, so a viewer moves the visuals of link k with it. Links that
    move relative to the base by other joints are not included.

    Raises:
        SceneError: a shape is invalid; the message gives file, line and element.
    """
    return _visuals(chain.robot, chain.bodies)


def visuals_of_bodies(robot: UrdfRobot, bodies: Bodies) -> tuple[Visuals | None, list[str]]:
    """Return the visuals of bodies (None without any), and notes on visuals that cannot be read.

    Args:
        robot: the links and joints in the file.
        bodies: bodies as in a `UrdfChain`.
    """
    try:
        visuals = _visuals(robot, bodies)
    except SceneError as cause:  # invalid visuals are no reason to refuse an arm
        return None, [f"{cause}; drawn with simple solids"]
    return Visuals(visuals, robot.folder, _packages_of(visuals, robot)) if any(visuals) else None, []


def _packages_of(visuals: tuple[tuple[Visual, ...], ...], robot: UrdfRobot) -> dict[str, str]:
    """Return the folders of the packages that names of meshes may refer to, so that later searches find the same."""
    shapes = [visual.shape for body in visuals for visual in body]
    names = {one.filename.partition("://")[2].partition("/")[0] for one in shapes if isinstance(one, Mesh)}
    search = PackageFolders(Path(robot.folder) if robot.folder else None, robot.packages)
    return {**robot.packages, **{name: str(at) for name in sorted(names - {""}) if (at := search.find(name))}}


def _visuals(robot: UrdfRobot, bodies: Bodies) -> tuple[tuple[Visual, ...], ...]:
    colours = _colours(robot)
    return tuple(
        tuple(
            _visual(visual, link, at, colours)
            for link, at in links.items()
            for visual in robot.links[link].element.children
            if visual.tag == "visual"
        )
        for links in bodies
    )


def _visual(element: Element, link: str, at: Pose, colours: dict[str, Rgba]) -> Visual:
    """Return one <visual> of a link with the given pose."""
    rgba = None
    if (material := element.first("material")) is not None:
        rgba = _rgba(material) or colours.get(material.attributes.get("name", ""))
    return Visual(link, at @ attributes.pose(element.first("origin")), _shape(element.required("geometry")), rgba)


def _shape(geometry: Element) -> VisualShape:
    """Return the one shape in a <geometry>."""
    known = ("box", "cylinder", "capsule", "sphere", "mesh")
    shapes = [child for child in geometry.children if child.tag in known]
    if len(shapes) != 1:
        raise geometry.refuse(f"expected one of {', '.join(known)}, got {len(shapes)} of them")
    (shape,) = shapes
    if shape.tag == "box":
        return Box(_three(shape, "size"))
    if shape.tag == "mesh":
        return Mesh(attributes.text(shape, "filename", "a file name"), _three(shape, "scale", (1.0, 1.0, 1.0)))
    radius = attributes.number(shape, "radius", at_least=0.0)
    if shape.tag == "sphere":
        return Sphere(radius)
    return {"cylinder": Cylinder, "capsule": Capsule}[shape.tag](
        radius, attributes.number(shape, "length", at_least=0.0)
    )


def _three(
    element: Element, attribute: str, default: tuple[float, float, float] | None = None
) -> tuple[float, float, float]:
    x, y, z = attributes.vector(element, attribute, default).tolist()
    return x, y, z


def _colours(robot: UrdfRobot) -> dict[str, Rgba]:
    """Return the colours of named materials in the whole file."""
    named = [child for child in robot.element.children if child.tag == "material"]
    for link in robot.links.values():
        named += [m for visual in link.element.children if visual.tag == "visual" and (m := visual.first("material"))]
    return {m.attributes.get("name", ""): rgba for m in reversed(named) if (rgba := _rgba(m)) is not None}


def _rgba(material: Element) -> Rgba | None:
    """Return the colour of a material, or None."""
    if (colour := material.first("color")) is None:
        return None
    r, g, b, a = attributes.numbers(colour, "rgba", 4, attributes.LARGEST_VALUE)
    return r, g, b, a
