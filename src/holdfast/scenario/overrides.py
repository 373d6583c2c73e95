"""Changes of a scene's keys from outside its file: `simulation.step=0.001`, `arms.left.q=[0, 0.5]`."""

from __future__ import annotations

import copy
import json
import re
from collections.abc import Iterator, Sequence
from typing import Any

from holdfast.errors import SceneError
from holdfast.io.files import one_line
from holdfast.io.typed import parse_toml, refusal
from holdfast.model import checks

BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")
SELECTOR_KEYS = ("name", "arm")  # keys whose value can select a table in a list, instead of its index


def overridden(raw: dict[str, Any], changes: Sequence[str]) -> dict[str, Any]:
    """Return a scene's plain data with some of its values replaced or added.

    Args:
        raw: parsed content of the file; it is not modified.
        changes: changes of the form `key=value`. The key is dotted, and a table in a list is selected by its index
            from 0 or by its `name` or `arm`. The value is TOML.

    Raises:
        SceneError: a change that is not of this form, or whose key does not exist in the scene.
    """
    found = copy.deepcopy(raw)
    for change in changes:
        key, equals, text = change.partition("=")
        keys = [part.strip() for part in key.split(".")]
        if not equals or not all(keys):
            raise _refused(change, "expected key=value, such as simulation.step=0.001")
        place: Any = found
        for depth, part in enumerate(keys[:-1], 1):
            if isinstance(place, dict):
                place.setdefault(part, {})
            place = place[_position(place, part, change, keys[: depth - 1])]
        place[_position(place, keys[-1], change, keys[:-1])] = _value(text, change)
    return found


def _position(place: Any, part: str, change: str, above: list[str]) -> str | int:
    """Return the key of an entry of a table, which may be new, or the index of an entry of a list.

    Raises:
        SceneError: `place` is neither a table nor a list, or the list has no such entry.
    """
    where = ".".join(above)
    if isinstance(place, dict):
        return part
    if not isinstance(place, list):
        raise _refused(change, f"expected a table or a list at {where}, got {place!r}")
    if part.isdecimal() and part.isascii() and int(part[:9]) < len(place):
        return int(part[:9])
    labels = {
        str(one[key]): k for k, one in enumerate(place) if isinstance(one, dict) for key in SELECTOR_KEYS if key in one
    }
    if part in labels:
        return labels[part]
    numbers = [str(k) for k in range(len(place))]
    raise _refused(change, f"no '{one_line(part, 60)}' in {where}.{checks.did_you_mean(part, [*labels, *numbers])}")


def _value(text: str, change: str) -> Any:
    """Return the value of a TOML expression.

    Raises:
        SceneError: the text is not a single TOML value.
    """
    try:
        found = parse_toml(f"value = {text.strip()}".encode(), "")
    except (SceneError, UnicodeEncodeError):
        found = {}
    if found.keys() != {"value"}:
        raise _refused(change, "expected a TOML value, such as 0.5, [0, 0, 1], true or, with its quotes, '\"text\"'")
    return found["value"]


def _refused(change: str, problem: str) -> SceneError:
    return refusal(f"--set {one_line(change, 100)}", problem)


def toml_text(raw: dict[str, Any]) -> str:
    """Return the plain data of a scene as TOML, with one line per key and one per table of a list."""
    return "".join(f"{line}\n" for key, value in raw.items() for line in _lines(key, value))


def _lines(key: str, value: Any) -> Iterator[str]:
    if isinstance(value, list) and any(isinstance(one, dict) for one in value):
        yield f"{_key(key)} = ["
        yield from (f"  {_inline(one)}," for one in value)
        yield "]"
    else:
        yield f"{_key(key)} = {_inline(value)}"


def _inline(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_key(key)} = {_inline(one)}" for key, one in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(_inline(one) for one in value) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    return _quoted(value) if isinstance(value, str) else repr(value)


def _key(key: str) -> str:
    return key if BARE_KEY.fullmatch(key) else _quoted(key)


def _quoted(text: str) -> str:
    """Return a TOML basic string, which is a JSON string except that DEL must be escaped too."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
