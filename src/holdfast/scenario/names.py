"""Checks of the names in a scene, which appear in messages, in paths 'arm/joint' and in column titles."""

from __future__ import annotations

import re
from collections.abc import Iterable

from holdfast.io.files import one_line
from holdfast.io.typed import Location

PATTERN = re.compile(r"\w[\w.-]{0,63}")


def require_names(names: Iterable[str], at: Location, *key: str, optional: bool = False) -> None:
    """Refuse repeated names, and names with characters that would be ambiguous in a path 'arm/joint'.

    Args:
        names: names of the members of a list.
        at: location of the list.
        *key: keys that lead from a member to its name.
        optional: whether a member may have no name, that is, an empty one.

    Raises:
        SceneError: a name that is refused, with the path of the first one.
    """
    first: dict[str, Location] = {}
    for i, name in enumerate(names):
        place = at / i
        for part in key:
            place = place / part
        if optional and not name:
            continue
        if not PATTERN.fullmatch(name):
            raise place.refuse(f"expected 1 to 64 letters, digits, '_', '-' and '.', got '{one_line(name, 60)}'")
        if name in first:
            raise place.refuse(f"'{name}' is already used at {first[name].path}")
        first[name] = place
