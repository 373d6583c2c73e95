"""The visuals of SDF links in the form in which URDF files have them, for viewers."""

from __future__ import annotations

from holdfast.robots.sdf.values import pose_in
from holdfast.robots.urdf.document import Element
from holdfast.robots.urdf.vocabulary import text_of
from holdfast.spatial import rotation

SHAPES = {"box": ("size",), "cylinder": ("radius", "length"), "capsule": ("radius", "length"), "sphere": ("radius",)}


def drawn(link: Element) -> Element:
    """Return a link's element with its visuals, those of other shapes left out."""
    found = Element("link", link.attributes, link.source, link.line, link.parent)
    found.children.extend(one for child in link.children if child.tag == "visual" for one in _visual(child))
    return found


def _visual(visual: Element) -> list[Element]:
    geometry, pose = visual.first("geometry"), visual.first("pose")
    shape = None if geometry is None else next((_shape(child) for child in geometry.children if _known(child)), None)
    if shape is None or (pose is not None and pose.attributes.get("relative_to")):
        return []
    at = pose_in(pose)
    turned = " ".join(repr(float(angle)) for angle in rotation.to_euler_zyx(at.R)[::-1])
    origin = _made(visual, "origin", {"xyz": " ".join(repr(float(x)) for x in at.p), "rpy": turned})
    parts = [origin, _made(visual, "geometry", {}, [shape])]
    material = visual.first("material")
    if material is not None and (diffuse := material.first("diffuse")) is not None:
        colour = _made(diffuse, "color", {"rgba": text_of(diffuse)})
        parts.append(_made(material, "material", {}, [colour]))
    return [_made(visual, "visual", {}, parts)]


def _known(shape: Element) -> bool:
    return shape.tag in SHAPES or shape.tag == "mesh"


def _shape(shape: Element) -> Element:
    if shape.tag == "mesh":
        texts = {key: text_of(child) for key in ("uri", "scale") if (child := shape.first(key)) is not None}
        stated = {"filename": texts.get("uri", "").replace("model://", "package://")}
        return _made(shape, "mesh", stated | ({"scale": texts["scale"]} if "scale" in texts else {}))
    return _made(shape, shape.tag, {k: text_of(one) for k in SHAPES[shape.tag] if (one := shape.first(k)) is not None})


def _made(of: Element, tag: str, attributes: dict[str, str], children: list[Element] | None = None) -> Element:
    return Element(tag, attributes, of.source, of.line, of.parent, children or [])
