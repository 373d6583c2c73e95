"""What the links of a URDF look like: its <visual> elements, for a viewer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from holdfast.errors import SceneError
from holdfast.model.visuals import Box, Capsule, Cylinder, Mesh, Rgba, Shape, Sphere, Visual, Visuals
from holdfast.robots.urdf import attributes
from holdfast.robots.urdf.document import Element
from holdfast.robots.urdf.robot import UrdfRobot
from holdfast.spatial.pose import Pose

Bodies = Sequence[Mapping[str, Pose]]


class Chain(Protocol):
    """What has visuals: a `UrdfChain` or a `UrdfTrunkChain`."""

    @property
    def robot(self) -> UrdfRobot:
        """The file's links and joints."""
        ...

    @property
    def bodies(self) -> Bodies:
        """Mappings from link name to pose: of the links on the base, then of those welded into each link."""
        ...


def urdf_visuals(chain: Chain) -> tuple[tuple[Visual, ...], ...]:
    """Return what the base and each link of an arm, or of a trunk, look like, N + 1 tuples. O(links).

    Poses are in the frame of the base, then of arm link k, so a viewer turns link k's
    visuals with it. Links that move on the base by joints of their own are not shown.

    Raises:
        SceneError: a shape that is none, with file, line and element.
    """
    return _visuals(chain.robot, chain.bodies)


def visuals_of_bodies(robot: UrdfRobot, bodies: Bodies) -> tuple[Visuals | None, list[str]]:
    """Return what bodies look like, None without visuals, and notes on what cannot be read of it.

    Args:
        robot: the file's links and joints.
        bodies: as those of a `UrdfChain`.
    """
    try:
        visuals = _visuals(robot, bodies)
    except SceneError as cause:  # no reason to refuse an arm
        return None, [f"{cause}; drawn with simple solids"]
    return Visuals(visuals, robot.folder) if any(visuals) else None, []


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
    """Return one <visual> of a link that lies at a pose."""
    rgba = None
    if (material := element.first("material")) is not None:
        rgba = _rgba(material) or colours.get(material.attributes.get("name", ""))
    return Visual(link, at @ attributes.pose(element.first("origin")), _shape(element.required("geometry")), rgba)


def _shape(geometry: Element) -> Shape:
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
    """Return the colours that materials are given by name, once for the whole file."""
    named = [child for child in robot.element.children if child.tag == "material"]
    for link in robot.links.values():
        named += [m for visual in link.element.children if visual.tag == "visual" and (m := visual.first("material"))]
    return {m.attributes.get("name", ""): rgba for m in reversed(named) if (rgba := _rgba(m)) is not None}


def _rgba(material: Element) -> Rgba | None:
    """Return a material's own colour, if it has one."""
    if (colour := material.first("color")) is None:
        return None
    r, g, b, a = attributes.numbers(colour, "rgba", 4, attributes.LARGEST)
    return r, g, b, a
