"""What the links of a URDF look like: boxes, cylinders, spheres and mesh files, for a viewer."""

from __future__ import annotations

from dataclasses import dataclass

from holdfast.robots.urdf import attributes
from holdfast.robots.urdf.chain import UrdfChain
from holdfast.robots.urdf.document import Element
from holdfast.robots.urdf.robot import UrdfRobot
from holdfast.robots.urdf.trunk import UrdfTrunkChain
from holdfast.spatial.pose import Pose

Rgba = tuple[float, float, float, float]


@dataclass(frozen=True)
class Box:
    """A box, centred.

    Attributes:
        size: edges along x, y, z [m].
    """

    size: tuple[float, float, float]


@dataclass(frozen=True)
class Cylinder:
    """A cylinder about z, centred.

    Attributes:
        radius: [m].
        length: [m].
    """

    radius: float
    length: float


@dataclass(frozen=True)
class Capsule:
    """A cylinder about z with half spheres on both ends, centred.

    Attributes:
        radius: [m].
        length: of the cylinder alone [m].
    """

    radius: float
    length: float


@dataclass(frozen=True)
class Sphere:
    """A sphere, centred.

    Attributes:
        radius: [m].
    """

    radius: float


@dataclass(frozen=True)
class Mesh:
    """A mesh in a file of its own.

    Attributes:
        filename: as the file says, `package://` and relative paths included.
        scale: along x, y, z.
    """

    filename: str
    scale: tuple[float, float, float]


Shape = Box | Cylinder | Capsule | Sphere | Mesh


@dataclass(frozen=True, eq=False)
class Visual:
    """One piece of what a link looks like.

    Attributes:
        link: name of the URDF link it belongs to.
        pose: in the frame of the arm's base or link.
        shape: what it is.
        rgba: colour, 0 to 1 each; None if the file gives none.
    """

    link: str
    pose: Pose
    shape: Shape
    rgba: Rgba | None


def urdf_visuals(chain: UrdfChain | UrdfTrunkChain) -> tuple[tuple[Visual, ...], ...]:
    """Return what the base and each link of an arm, or of a trunk, look like, N + 1 tuples. O(links).

    Poses are in the frame of the base, then of arm link k, so a viewer turns link k's
    visuals with it. Links that move on the base by joints of their own are not shown.

    Raises:
        SceneError: a shape that is none, with file, line and element.
    """
    colours = _colours(chain.robot)
    return tuple(
        tuple(
            _visual(visual, link, at, colours)
            for link, at in links.items()
            for visual in chain.robot.links[link].element.children
            if visual.tag == "visual"
        )
        for links in chain.bodies
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
