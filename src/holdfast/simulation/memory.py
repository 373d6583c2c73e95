"""Plain memories (numbers, arrays, and tuples, lists, dicts of them) as arrays and JSON-able data."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from holdfast.errors import ResultError
from holdfast.spatial.scalar import Array

_NUMBERS = {bool: "bool", int: "int", float: "float"}


def packed(value: Any, name: str, arrays: dict[str, Array]) -> Any:
    """Return what a value consists of, as plain data; its numbers go into the arrays.

    Args:
        value: None, a truth value, a number, a text, an array, or a tuple, list or dict of these.
        name: for messages, and part of the names of the arrays.
        arrays: where the numbers go.

    Raises:
        ResultError: naming what cannot be written, and where it is.
    """
    kind = type(value)
    if value is None or kind is str:
        return {"text": value}
    if kind in (tuple, list):
        return {kind.__name__: [packed(item, f"{name}[{i}]", arrays) for i, item in enumerate(value)]}
    if kind is dict and all(type(key) is str for key in value):
        return {"dict": {key: packed(item, f"{name}.{key}", arrays) for key, item in value.items()}}
    place = f"{name}:{len(arrays)}"  # numbered: keys may hold any letters
    if isinstance(value, np.ndarray | np.generic) and np.asarray(value).dtype.kind in "biufcU":
        arrays[place] = np.array(value)
        return {"array" if isinstance(value, np.ndarray) else "scalar": place}
    if type(value) in (bool, float) or (type(value) is int and abs(value) < 2**63):
        arrays[place] = np.array(value)
        return {_NUMBERS[kind]: place}
    raise ResultError(
        f"{name}: expected None, numbers (of 64 bits), texts, arrays, or tuples, lists and dicts (with text keys) of"
        f" them, got {kind.__name__}; try to remember these instead, or to simulate without saving"
    )


def unpacked(data: Mapping[str, Any], arrays: Mapping[str, Array]) -> Any:
    """Return the value that `packed` took apart; the numbers are the same to the last bit."""
    ((kind, value),) = data.items()
    if kind == "text":
        return value
    if kind in ("tuple", "list"):
        items = [unpacked(item, arrays) for item in value]
        return tuple(items) if kind == "tuple" else items
    if kind == "dict":
        return {key: unpacked(item, arrays) for key, item in value.items()}
    numbers = np.array(arrays[value])
    return numbers if kind == "array" else numbers[()] if kind == "scalar" else numbers[()].item()
