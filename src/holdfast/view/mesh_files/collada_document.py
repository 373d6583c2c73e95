"""A Collada file as XML elements with their text: no DOCTYPE, so no entities, and bounded in number and depth."""

from __future__ import annotations

from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from holdfast.view.mesh_files.limits import MeshFault

MOST_ELEMENTS = 200_000
DEEPEST = 200


def parse_collada(content: bytes) -> Element:
    """Return the root element; tags are without prefixes.

    Raises:
        MeshFault: not well-formed, not Collada, or beyond the bounds.
    """
    builder, parser = TreeBuilder(), expat.ParserCreate()
    depth = count = 0

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth, count
        depth, count = depth + 1, count + 1
        if depth > DEEPEST or count > MOST_ELEMENTS:
            raise MeshFault(f"expected at most {MOST_ELEMENTS:,} elements in {DEEPEST} levels, got more")
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
