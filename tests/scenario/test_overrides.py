"""Keys set from outside a scene, and plain data written as TOML."""

import math
import tomllib

import numpy as np
import pytest

from holdfast.errors import SceneError
from holdfast.scenario.overrides import overridden, toml_text

RAW = {"a": 1, "list": [{"name": "left", "q": [1.0, 2.0]}, {"arm": "right"}], "table": {"b": {"c": True}}}


@pytest.mark.parametrize(
    ("change", "read"),
    [
        ("a=2", lambda d: d["a"] == 2),
        (" a = 'x' ", lambda d: d["a"] == "x"),
        ("list.left.q=[3]", lambda d: d["list"][0]["q"] == [3]),
        ("list.0.q.1=-1e-3", lambda d: d["list"][0]["q"] == [1.0, -1e-3]),
        ("list.right.k={x = 1}", lambda d: d["list"][1]["k"] == {"x": 1}),
        ("table.b.c=false", lambda d: d["table"]["b"]["c"] is False),
        ("new.one.two=1", lambda d: d["new"] == {"one": {"two": 1}}),
        ("a='k=v'", lambda d: d["a"] == "k=v"),
    ],
)
def test_set(change, read):
    """The value is where the key leads, everything else as it was, and the file's own data too."""
    before = repr(RAW)
    found = overridden(RAW, [change])
    assert read(found)
    assert repr(RAW) == before
    key = change.partition("=")[0].strip().partition(".")[0]
    assert {k: v for k, v in found.items() if k != key} == {k: v for k, v in RAW.items() if k != key}


def test_in_their_order():
    """A later change sees the earlier ones."""
    assert overridden(RAW, ["x={}", "x.y=1", "x.y=2"])["x"] == {"y": 2}


@pytest.mark.parametrize("change", ["", "a", "=1", "a=", "a=1\nb=2", "a.b=1", "list.up.q=1", "list.2=1", "a=b", "a=[1"])
def test_refused(change):
    """By the change's own text."""
    with pytest.raises(SceneError, match="--set"):
        overridden(RAW, [change])


def test_text_reads_as_the_data():
    """Whatever a scene may hold: the standard library reads the same values and types, to the bit."""
    rng = np.random.default_rng(3)

    def text():
        return "".join(map(chr, rng.choice([*range(1, 128), 0xE9, 0x2028, 0x1F600], rng.integers(0, 9)).tolist()))

    def value(depth):
        kind = rng.integers(0, 7 if depth else 5)
        if kind == 5:
            return [value(depth - 1) for _ in range(rng.integers(0, 4))]
        if kind == 6:
            return {text(): value(depth - 1) for _ in range(rng.integers(0, 4))}
        number = float(math.ldexp(rng.normal(), int(rng.integers(-300, 300))))
        return (number, -0.0, int(rng.integers(-(10**12), 10**12)), bool(number > 0), text())[kind]

    for _ in range(200):
        data = {text(): value(4) for _ in range(4)}
        assert repr(tomllib.loads(toml_text(data))) == repr(data)
