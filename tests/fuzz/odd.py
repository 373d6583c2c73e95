"""Arguments made wrong: a number, an array, a name or a part in place of another, at a random place."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from datetime import date
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

import holdfast as hf
from tests.model.parts import BOX, arm

Where = tuple[Any, ...]

MISNAMED = 0.2  # share of calls with wrong names

NUMBERS = (0, -1, 2, 0.5, -0.0, 1e-200, 5e-324, 1e200, -1e200, 1e308, 1e-9, 1e9, 2**40, 2**63, 10**30, 10**400)
NO_NUMBERS = (float("nan"), float("inf"), float("-inf"), 1j, "1", "", "nan", b"1", None, True, False, "\0", "x" * 300)
THINGS = (
    (),
    [],
    {},
    set(),
    object(),
    int,
    len,
    range(3),
    Decimal("NaN"),
    Decimal("1.5"),
    np.float32(0.5),
    np.int8(3),
    np.ma.masked,
    np.array("x"),
    np.array(None),
    date(2020, 1, 1),
    Path("none/there"),
    hf.Pose.identity(),
    hf.Inputs(),
    BOX,
    arm(2),
    lambda *given: given,
    lambda *given: 1 / 0.5,
    [[1.0], [1.0, 2.0]],
    ["q", "q"],
    {"q": 1.0},
    {1: 2.0},
)
NAMES = (
    "q",
    "qdd",
    "tau",
    "grasp_wrench",
    "object_pose",
    "position",
    "rk4",
    "base",
    "trunk",
    "world",
    "object",
    "left",
)
COUNTS = (0, -1, 3, 1.5, "3", float("nan"), True, None, 2**40, 10**30)


def odd(dice: random.Random, value: Any) -> Any:
    """Return something odd in place of a value, often of nearly its kind."""
    if isinstance(value, np.ndarray) and value.dtype.kind in "fiu" and dice.random() < 0.8:
        return odd_array(dice, value)
    if isinstance(value, str) and dice.random() < 0.7:
        return dice.choice([*NAMES, *NO_NUMBERS, value.upper(), value[:-1], value + "s", [value], (value, value)])
    if isinstance(value, int) and dice.random() < 0.7:
        return dice.choice(COUNTS)
    if isinstance(value, float) and dice.random() < 0.7:
        return dice.choice([*NUMBERS, *NO_NUMBERS, 1.5 * value, -value])
    if isinstance(value, list | tuple) and dice.random() < 0.5:
        kinds: list[Any] = [value[:-1], [*value, *value], value[::-1], iter(value), list(value)[:1] * 3]
        return dice.choice(kinds)
    return dice.choice([*NUMBERS, *NO_NUMBERS, *THINGS])


def odd_array(dice: random.Random, x: np.ndarray) -> Any:
    """Return an array spoilt: entries, shape, kind of numbers, or how it lies in memory."""
    if not x.size or dice.random() < 0.45:
        y = np.array(x, dtype=float)
        some = dice.choice([float("nan"), float("inf"), 1e200, -1e200, 1e308, 1e-200, 0.0, 1e5, 1e20, -1.0])
        if y.size and dice.random() < 0.7:
            y.flat[dice.randrange(y.size)] = some
        else:
            y[...] = some
        return y
    with np.errstate(all="ignore"):  # what a caller's own conversion loses is not ours
        return dice.choice(SPOILT)(x)


class Failing:
    """Converts itself to an array with an error of its own."""

    def __array__(self, *given: Any, **options: Any) -> np.ndarray:
        raise RuntimeError("not today")


SPOILT: tuple[Callable[[np.ndarray], Any], ...] = (
    lambda x: x[..., :-1],
    lambda x: x[None],
    lambda x: np.stack([x, x, x]),
    lambda x: x.T,
    lambda x: x.ravel(),
    lambda x: x[..., :0],
    lambda x: x.reshape(-1)[0],
    lambda x: np.repeat(x, 2, axis=-1)[..., ::2],  # every other number of memory
    lambda x: x[..., ::-1],
    lambda x: np.asfortranarray(x),
    lambda x: x.astype(">f8"),
    lambda x: x.astype("f4"),
    lambda x: x.astype(np.longdouble),
    lambda x: x.astype("f2"),
    lambda x: np.clip(x, -9.0, 9.0).astype(int),
    lambda x: x.astype(bool),
    lambda x: x.astype(complex),
    lambda x: x.astype(object),
    lambda x: x.astype(str),
    lambda x: x.astype(str).astype(object),
    lambda x: x.tolist(),
    lambda x: str(x.tolist()),
    lambda x: np.ma.masked_array(x, x > 0),
    lambda x: np.broadcast_to(x.reshape(-1)[0], x.shape),
    lambda x: memoryview(np.ascontiguousarray(x)),
    lambda x: iter(x.reshape(-1)),
    lambda x: [x.tolist(), 1.0],
    lambda x: np.zeros((0, *x.shape)),
    lambda x: Failing(),
    lambda x: {"x": x},
)


def places(value: Any, where: Where = ()) -> list[Where]:
    """Return every place in nested arguments, outer ones too."""
    inner: Mapping[Any, Any] = {}
    if isinstance(value, dict):
        inner = value
    elif isinstance(value, list | tuple):
        inner = dict(enumerate(value))
    return [where] * bool(where) + [one for key, x in inner.items() for one in places(x, (*where, key))]


def put(value: Any, where: Where, new: Callable[[Any], Any]) -> Any:
    """Return nested arguments with another thing at one place; all others as they were."""
    if not where:
        return new(value)
    key, *rest = where
    changed = {**value} if isinstance(value, dict) else list(value)
    changed[key] = put(value[key], tuple(rest), new)
    return changed if isinstance(value, dict) else type(value)(changed)


def misspelt(dice: random.Random, name: str) -> str:
    """Return a name with a letter left out, doubled or exchanged with the next."""
    k = dice.randrange(len(name))
    a, b, rest = name[:k], name[k], name[k + 1 :]
    return dice.choice([a + rest, a + b + b + rest, a + rest[:1] + b + rest[1:], name + "s"])


def misnamed(dice: random.Random, given: dict[str, Any], names: list[str]) -> tuple[dict[str, Any], Where, Any]:
    """Return arguments of which one has a wrong name, is missing or is unknown; which, and what is wrong."""
    name = dice.choice(names)
    how = dice.choice(["misspelt", "missing", "unknown"])
    if how == "unknown":
        return {**given, "colour": 1.0}, ("colour",), how
    wrong = {key: x for key, x in given.items() if key != name}
    if how == "misspelt" and (other := misspelt(dice, name)) not in given:
        return {**wrong, other: given[name]}, (other,), how
    return wrong, (name,), "missing"


def spoilt(
    dice: random.Random, given: dict[str, Any], names: list[str]
) -> tuple[dict[str, Any], list[tuple[Where, Any]]]:
    """Return arguments made wrong at one place or two, and what is where; now and then an argument of another name.

    Args:
        dice: random numbers.
        given: sound arguments.
        names: those of them whose names may be wrong.
    """
    changes: list[tuple[Where, Any]] = []
    if names and dice.random() < MISNAMED:
        wrong, where, how = misnamed(dice, given, names)
        return wrong, [(where, how)]
    for _ in range(dice.choice([1, 1, 1, 1, 2])):
        where = dice.choice(places(given))

        def new(old: Any, where: Where = where) -> Any:
            changes.append((where, odd(dice, old)))
            return changes[-1][1]

        given = put(given, where, new)
    return given, changes
