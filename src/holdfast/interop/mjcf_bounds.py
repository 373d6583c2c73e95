"""How much an MJCF file may ask for: MuJoCo's compiler makes room for whatever counts it is given."""

from __future__ import annotations

import math
import os
from pathlib import Path

from holdfast.errors import SceneError
from holdfast.robots.urdf.document import LARGEST_FILE, Element, parse_document

MOST = 2**24  # of what an element asks for: pixels, heights, copies, keys
MOST_COPIES = 10_000
MOST_INCLUDED = 1000
# (element, attributes whose product counts)
COUNTS = {
    "texture": ("width", "height"),
    "hfield": ("nrow", "ncol"),
    "composite": ("count",),
    "flexcomp": ("count",),
    "size": ("njmax", "nconmax", "nstack", "nuserdata", "nkey", "nuser_body", "nuser_jnt", "nuser_geom", "nuser_site"),
}


def bounded_mjcf(text: bytes | str, source: str, folder: Path) -> Element:
    """Return the root element of an MJCF file, after a look at it and at all that it includes.

    Raises:
        SceneError: not well-formed, a DOCTYPE, too large, or a count beyond the bounds.
    """
    root = parse_document(text, source)
    waiting, seen = [root], 1
    while waiting:
        for element, copies in _within(waiting.pop(), 1.0):
            _require_bounded(element, copies)
            if element.tag != "include" or not element.attributes.get("file"):
                continue
            path = folder / element.attributes["file"]
            if not os.path.isfile(path):  # MuJoCo says so
                continue
            seen += 1
            if seen > MOST_INCLUDED:
                raise element.refuse(f"expected at most {MOST_INCLUDED} included files, got more")
            with path.open("rb") as file:
                waiting.append(parse_document(file.read(LARGEST_FILE + 1), str(path)))
    return root


def _within(root: Element, copies: float) -> list[tuple[Element, float]]:
    """Return every element with how many copies of it are asked for."""
    found, waiting = [], [(root, copies)]
    while waiting:
        element, copies = waiting.pop()
        if element.tag == "replicate":
            copies *= max(_product(element, ("count",)), 1.0)
        found.append((element, copies))
        waiting += [(child, copies) for child in element.children]
    return found


def _require_bounded(element: Element, copies: float) -> None:
    if copies > MOST_COPIES:
        raise element.refuse(f"expected at most {MOST_COPIES:,} copies of it (replicate), got {copies:g}")
    asked = _product(element, COUNTS.get(element.tag, ())) if element.tag != "size" else 0.0
    if element.tag == "size":
        asked = max((_product(element, (name,)) for name in COUNTS["size"]), default=0.0)
    if asked > MOST:
        raise element.refuse(f"expected counts up to {MOST:,}, got {asked:g}")


def _product(element: Element, names: tuple[str, ...]) -> float:
    """Return the product of all numbers in some attributes; what is no number is MuJoCo's to refuse."""
    found = []
    for name in names:
        for word in element.attributes.get(name, "").split()[:10]:
            try:
                found.append(abs(float(word)))
            except ValueError:
                return 0.0
    product = math.prod(found) if found else 0.0
    return product if product == product else 0.0


def read_mjcf(path: str) -> bytes:
    """Return a file's bytes, one more than it may have at most.

    Raises:
        SceneError: it cannot be read.
    """
    try:
        if os.path.exists(path) and not (os.path.isfile(path) or os.path.isdir(path)):
            raise OSError("is not a file")
        with open(path, "rb") as file:
            return file.read(LARGEST_FILE + 1)
    except OSError as cause:
        raise SceneError(f"{path}: cannot be read: {cause.strerror or cause}") from cause
    except ValueError as cause:
        raise SceneError(f"{path!r}: cannot be read: {cause}") from cause
