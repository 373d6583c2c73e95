"""Loops of a function while it is traced: the schedule that follows, against the function on floats."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from holdfast.compiled.traced_chain import traced
from holdfast.compiler.errors import CompileError
from holdfast.compiler.interpret import interpret_schedule
from holdfast.compiler.schedule import External
from holdfast.spatial.scalar import array, each, maximum, scan, sqrt, where
from tests.compiler.programs import ArrayKernel

ON = (1, 3, 3, 5, 6)  # link that each arm sits on: some carry none, one carries two


def tree(x):
    """Return what a tree of three levels finds: arms outward, links to the root and back, a pass of two columns."""
    gain = array([2.0 * x["k"][0], x["k"][1]])

    def outward(q):
        weight = q * q + gain[0]
        return weight, lambda s: weight * s + q

    arms = each(outward, x["arms"])
    heaviest, _ = scan(lambda worst, arm: (maximum(worst, arm[0][0]), None), 0.0, arms)
    parents = [max(0, (k - 1) // 2) for k in range(7)]
    loads = {k: sum((arm[0] for arm, on in zip(arms, ON, strict=True) if on == k), np.zeros(3)) for k in range(7)}

    def inward(t, load):
        D = t[0] * t[0] + load @ load + 1.0
        return load / D + t[1] * load, lambda s: (s * t[0] + load) / D

    steps = {}
    for first, last in ((3, 7), (1, 3), (0, 1)):  # branches meet between levels
        level = range(first, last)
        found = each(inward, [x["links"][k] for k in level], [loads[k] for k in level])
        steps |= dict(zip(level, [step for _, step in found], strict=True))
        for k, (up, _) in zip(level, found, strict=True):
            loads[parents[k]] = loads[parents[k]] + up
    down = dict(zip([0], each(lambda step, s: step(s), [steps[0]], [x["root"]]), strict=True))
    for first, last in ((1, 3), (3, 7)):
        level = range(first, last)
        found = each(lambda step, s: step(s), [steps[k] for k in level], [down[parents[k]] for k in level])
        down |= dict(zip(level, found, strict=True))
    back = each(lambda arm, s: arm[1](s), arms, [down[k] for k in ON])
    columns = each(lambda arm, s: array([arm[1](s), arm[1](2.0 * s)]), arms, back)
    return {"back": np.concatenate(back), "columns": np.concatenate(columns).ravel(), "heaviest": array([heaviest])}


def chained(x):
    """Return a scan whose carry changes its shape on the way, gone back through, with a result of the glue."""

    def wide(carry, t):
        a, b = carry
        c = a * t[0] + b[0]
        return (c, b + t[1] * a), lambda s: (s * c[0] + a, s @ b)

    def narrow(carry, t):
        return carry + t[0], lambda s: (s + carry * t[1], s[0])

    (a, b), first = scan(wide, (np.zeros(3), x["b"]), x["links"][:3])
    total = sqrt(a @ a + 1.0)
    c, then = scan(narrow, a / total + b, x["links"][3:])
    s, found = scan(lambda s, step: step(s), c, then[::-1])
    s, more = scan(lambda s, step: step(s), s * total, first[::-1])
    longer, sizes = scan(lambda c, t: (np.concatenate([c, t * c[0]]), c @ c), x["b"], x["links"])
    return {
        "s": s,
        "found": array([*found, *more]),
        "total": where(total > 2.0, c, s),
        "longer": longer,
        "sizes": sizes,
    }


@dataclass(frozen=True, eq=False)
class Reading:
    """What a loop may return: with a default, a method, a function and another of its kind."""

    x: Any
    scale: Any = 1.0
    back: Callable[[Any], Any] | None = None
    inner: Any = None

    def scaled(self):
        """Return the product of two fields."""
        return self.scale * self.x


def records(x):
    """Return what loops over dataclasses find that the function between them uses, copies, mixes and hands on."""

    def read(q):
        return Reading(q + q[0], q[1], lambda s: s * q, Reading(q * q))

    found = each(read, x["arms"])
    assert all(isinstance(r, Reading) and not hasattr(r, "where") and r.inner.back is None for r in found)
    total = sum((r.inner.x for r in found[1:]), np.zeros(3))
    copies = [replace(r, scale=total[0]) for r in found]
    again = each(lambda r, s: r.back(s) + r.inner.scaled(), found, [r.x for r in copies])
    scaled = each(lambda r: r.scaled(), copies)
    mixed = each(lambda r: r.scaled(), [found[0], copies[1], *found[2:]])
    summed, _ = scan(lambda c, r: (c + r.inner.scaled(), None), total, found[::-1])
    return {"y": np.concatenate([*again, *scaled, *mixed, summed])}


FUNCTIONS = {
    "records": (records, {"arms": (len(ON), 3)}),
    "tree": (tree, {"arms": (len(ON), 3), "links": (7, 2), "root": (3,), "k": (2,)}),
    "chained": (chained, {"links": (5, 2), "b": (3,)}),
}


def numbers(shapes, seed):
    """Return random inputs."""
    random = np.random.default_rng(seed)
    return {name: random.normal(size=shape) for name, shape in shapes.items()}


@pytest.mark.parametrize("lanes", [2, 4, 8])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_same_bits(name, lanes):
    """Interpreter, scalar code, lanes, batches and tails agree to the bit; the function on floats to rounding."""
    function, shapes = FUNCTIONS[name]
    expected = function(numbers(shapes, 0))
    externals = {what: External(shape, "parameter" if what == "k" else "input") for what, shape in shapes.items()}
    externals |= {what: External(np.shape(x), "output") for what, x in expected.items()}
    schedule = traced(externals, function)
    kernel = ArrayKernel(externals, lambda: schedule, lanes=lanes)
    systems = [numbers(shapes, seed) for seed in range(2 * lanes + 1)]
    found = [interpret_schedule(schedule, system) for system in systems]
    for system, read in zip(systems, found, strict=True):
        for what, x in function(system).items():
            np.testing.assert_allclose(read[what], np.asarray(x), rtol=1e-12, atol=1e-12)
        assert all(np.array_equal(a, b) for a, b in zip(kernel(*system.values()), read.values(), strict=True))
    batch = kernel(*(np.stack([system[what] for system in systems]) for what in shapes))
    for x, what in zip(batch, expected, strict=True):
        assert np.array_equal(x, np.stack([read[what] for read in found]))


def test_one_of_a_type_is_traced():
    """However many items there are; others of another constant are of another type."""
    traces = []

    def function(x):
        def one(q, c):
            traces.append(c)
            return q * c

        return {"y": np.concatenate(each(one, x["q"], [2.0, 3.0, 2.0, 2.0, 3.0]))}

    externals = {"q": External((5, 2), "input"), "y": External((10,), "output")}
    schedule = traced(externals, function)
    assert traces == [2.0, 3.0]
    assert sorted(group.count for group in schedule.groups.values()) == [2, 3]
    assert [wire.array for group in schedule.groups.values() for wire in group.wires.values()] == ["q", "y"] * 2


def test_the_line_is_named():
    """Of what cannot be traced, also inside a loop."""

    def function(x):
        return {"y": np.concatenate(each(lambda q: q if q[0] > 0.0 else -q, x["q"]))}

    with pytest.raises(CompileError, match=r"test_composition.*each\(lambda q: q if q\[0\] > 0.0"):
        traced({"q": External((5, 2), "input"), "y": External((10,), "output")}, function)


def test_truths_do_not_leave_a_loop():
    """They are no numbers."""

    def function(x):
        found = each(lambda q: q[0] > 0.0, x["q"])
        return {"y": array([where(one, 1.0, 2.0) for one in found])}

    with pytest.raises(CompileError, match="truth of a comparison"):
        traced({"q": External((5, 2), "input"), "y": External((5,), "output")}, function)


def test_long_functions():
    """Between loops and inside them: no recursion follows the operations."""

    def long(x):
        for _ in range(3000):
            x = x / (1.25 + x * x)
        return x

    def function(x):
        return {"y": np.concatenate(each(lambda q: long(q) + long(x["q"][0]), x["q"]))}

    externals = {"q": External((2, 1), "input"), "y": External((2,), "output")}
    found = interpret_schedule(traced(externals, function), {"q": np.array([[0.7], [-0.3]])})["y"]
    expected = function({"q": np.array([[0.7], [-0.3]])})["y"]
    np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_read_in_lanes_and_shared():
    """What one item after the other finds is read item by item, and one of it by all."""

    def function(x):
        _, found = scan(lambda c, q: (c + q, c * q), np.zeros(2), x["q"])
        each_own = each(lambda q, own: q * own, x["q"], found)
        return {"y": np.concatenate(each_own + each(lambda q: q - found[1], x["q"]))}

    externals = {"q": External((5, 2), "input"), "y": External((20,), "output")}
    schedule = traced(externals, function)
    given = {"q": np.arange(10.0).reshape(5, 2) - 3.0}
    assert np.array_equal(ArrayKernel(externals, lambda: schedule, lanes=4)(given["q"])[0], function(given)["y"])
    assert np.array_equal(interpret_schedule(schedule, given)["y"], function(given)["y"])
