"""Case files to spoil: places in them, and ways to replace what stands there."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

CASES = json.loads((Path(__file__).parents[1] / "data" / "cases.json").read_text())["cases"]
SMALL_CASE = json.dumps(
    {
        key: next(case for case in CASES if case["name"] == "mixed_4arm_all_types")[key]
        for key in ("name", "gravity", "object", "arms", "expected")
    }
)
Where = tuple[str | int, ...]


def small_case() -> dict:
    """Return a case with one arm of every grasp, nothing optional left out but free-form notes."""
    return json.loads(SMALL_CASE)  # many times faster than a deep copy


def arm_with(kind: str) -> int:
    """Return the index of the small case's arm of a grasp kind."""
    return next(i for i, arm in enumerate(small_case()["arms"]) if arm["grasp"]["type"] == kind)


def places(data: Any, where: Where = ()) -> Iterator[Where]:
    """Yield every place below, of a list only the first and last item."""
    if where:
        yield where
    if isinstance(data, dict):
        for key, value in data.items():
            yield from places(value, (*where, key))
    elif isinstance(data, list):
        for i in sorted({0, len(data) - 1}) if data else []:
            yield from places(data[i], (*where, i))


def at(data: Any, where: Where) -> Any:
    """Return what stands at a place."""
    for key in where:
        data = data[key]
    return data


def replaced(where: Where, value: Any) -> dict:
    """Return the small case with a value put at a place."""
    case = small_case()
    at(case, where[:-1])[where[-1]] = value
    return case


def without(where: Where) -> dict:
    """Return the small case with a key, or a list's item, taken out."""
    case = small_case()
    del at(case, where[:-1])[where[-1]]
    return case


def renamed(where: Where, key: str) -> dict:
    """Return the small case with the key at a place renamed, its position kept."""
    case = small_case()
    parent = at(case, where[:-1])
    items = [(key if k == where[-1] else k, v) for k, v in parent.items()]
    parent.clear()
    parent.update(items)
    return case


def path(where: Where) -> str:
    """Return the JSON path `$.arms[0].tip` of a place."""
    return "$" + "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in where)


def with_token(where: Where, token: str) -> str:
    """Return the text of the small case with a bare token, such as NaN, at a place."""
    return json.dumps(replaced(where, "@token@")).replace('"@token@"', token)
