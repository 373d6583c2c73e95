"""Names in a scene: they stand on lines, in paths 'arm/joint' and in titles of columns."""

from __future__ import annotations

import re
from collections.abc import Iterable

from holdfast.io.files import one_line
from holdfast.io.typed import Location

NAME = re.compile(r"\w[\w.-]{0,63}")


def require_names(names: Iterable[str], at: Location, *key: str, optional: bool = False) -> None:
    """Refuse names that repeat, or that would not fit on a line or in a path 'arm/joint'.

    Args:
        names: of members of a list.
        at: the list's place.
        *key: where a member has its name.
        optional: whether a member may have none, an empty one.

    Raises:
        SceneError: with the place of the first fault.
    """
    first: dict[str, Location] = {}
    for i, name in enumerate(names):
        place = at / i
        for part in key:
            place = place / part
        if optional and not name:
            continue
        if not NAME.fullmatch(name):
            raise place.refuse(f"expected 1 to 64 letters, digits, '_', '-' and '.', got '{one_line(name, 60)}'")
        if name in first:
            raise place.refuse(f"'{name}' is already used at {first[name].path}")
        first[name] = place
