"""Schedules: the interpreter's bits alone, bound, in lanes of items, in lanes of systems, in tails, in threads."""

import random
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from holdfast.compiler.interpret import interpret_schedule
from holdfast.compiler.schedule import FIRST_BAD, NOT_FINITE, Call, External, Group, Internal, Schedule
from holdfast.compiler.stage import Wire
from holdfast.compiler.targets import split
from holdfast.compiler.targets.layout import Layout
from tests.compiler.programs import COUNTS, ArrayKernel, Writer, all_same_bits, inputs_of, same_bits, schedules, stage


def kernel_of(schedule: Schedule, lanes: int) -> ArrayKernel:
    """Return the compiled schedule."""
    return ArrayKernel(schedule.externals, lambda: schedule, lanes=lanes)


def check(schedule: Schedule, kernel: ArrayKernel, systems: list[dict[str, np.ndarray]], shared: bool) -> list[float]:
    """All backends of all systems agree to the bit; returns their statuses."""
    if shared:
        parameters = {name: systems[0][name] for name in schedule.names("parameter")}
        systems = [system | parameters for system in systems]
    expected = [interpret_schedule(schedule, system) for system in systems]
    bound = kernel.bind()
    for k, (system, results) in enumerate(zip(systems, expected, strict=True)):
        for name, x in system.items():
            bound.arrays[name][...] = x
        if not (shared and k):
            bound.prepare()
        status = bound.run()
        for name, x in results.items():
            assert same_bits(bound.arrays[name], x), (k, name)
        assert status == (results[schedule.status] if schedule.status else 0)
        assert all_same_bits(kernel(*system.values()), tuple(results.values()))
    roles = {name: external.role for name, external in schedule.externals.items()}
    for size in sorted({*range(1, min(len(systems), kernel.lanes + 1) + 1), len(systems)}):
        stacked = [
            systems[0][name] if shared and roles[name] == "parameter" else np.stack([s[name] for s in systems[:size]])
            for name in systems[0]
        ]
        wanted = tuple(np.stack([results[name] for results in expected[:size]]) for name in expected[0])
        for threads in (1, 3):
            assert all_same_bits(kernel(*stacked, threads=threads), wanted), (size, threads)
    return [float(results[schedule.status]) for results in expected] if schedule.status else []


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(schedules(), st.sampled_from([2, 4, 8]), st.integers(0, 2**32), st.booleans(), st.booleans(), st.booleans())
def test_same_bits(schedule, lanes, seed, wild, shared, short):
    """Random schedules, with long functions and with ones that are cut after five operations."""
    with pytest.MonkeyPatch.context() as patch:
        if short:
            patch.setattr(split, "LONGEST_PART", 5)
            patch.setattr(split, "LONGEST_OF_GROUPS", 5)
        kernel = kernel_of(schedule, lanes)
        kernel.run_batch(np.zeros((len(schedule.externals), 2), dtype=np.int64), 0)  # compiles
    systems = [inputs_of(schedule, seed + k, wild) for k in range(2 * lanes + 3)]
    check(schedule, kernel, systems, shared)


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("lanes", [2, 4, 8])
def test_counts(count, lanes):
    """Every number of items, fewer and more than the lanes, beside a group of another size."""
    writer = Writer(random.Random(100 * count + lanes), [count, 3], [True, True])
    schedule = writer.schedule(("z", "seen", "sum"))
    check(schedule, kernel_of(schedule, lanes), [inputs_of(schedule, k, wild=False) for k in range(lanes + 2)], False)


def watched(small: int, large: int) -> Schedule:
    """Return a schedule that hands its inputs on: two of them guarded, one not, and a status."""
    shapes = {"small": (small,), "large": (large,), "free": (2,), "code": ()}
    function = lambda *arrays: arrays  # noqa: E731
    names = tuple(f"{name}.out" for name in shapes)
    copy = stage("copy", function, [shapes], [names])
    externals = {name: External(shape, "input") for name, shape in shapes.items()}
    externals |= {f"{name}.out": External(shape, "output") for name, shape in shapes.items()}
    group = Group(copy, 1, {name: Wire(name, (0,)) for name in externals}, side_by_side=False)
    return Schedule(externals, {}, {"copy": group}, (), (Call("copy", 0, (0,)),), "code.out", names[:2])


@pytest.mark.parametrize("code", [0.0, 1.0, 2.0, 3.0, 4.0, 5.0])
@pytest.mark.parametrize("lanes", [2, 4, 8])
def test_status(code, lanes):
    """Below 3 results are as computed; from 3 on guarded ones are not-a-number."""
    schedule = watched(5, 37)
    random_ = np.random.default_rng(int(code))
    system = {name: random_.normal(size=schedule.externals[name].shape) for name in schedule.names("input")}
    system["code"] = np.array(code)
    kernel = kernel_of(schedule, lanes)
    assert check(schedule, kernel, [system], shared=False) == [code]
    small, large, free, status = kernel(*system.values())
    assert status == code and np.array_equal(free, system["free"])
    if code < FIRST_BAD:
        assert np.array_equal(small, system["small"]) and np.array_equal(large, system["large"])
    else:
        assert np.isnan(small).all() and np.isnan(large).all()


@pytest.mark.parametrize(("small", "large"), [(1, 33), (5, 37), (8, 64), (32, 40)])
@pytest.mark.parametrize("lanes", [2, 4, 8])
def test_every_number_is_watched(small, large, lanes):
    """One infinity or NaN in any place of a guarded result sets the status of its system alone."""
    schedule = watched(small, large)
    kernel = kernel_of(schedule, lanes)
    places = [("small", i) for i in range(small)] + [("large", i) for i in range(large)] + [("free", 0), ("free", 1)]
    batch = {name: np.ones((len(places), *schedule.externals[name].shape)) for name in schedule.names("input")}
    batch["code"][:] = 1.0
    for k, (name, i) in enumerate(places):
        batch[name][k, i] = (np.inf, -np.inf, np.nan)[k % 3]
    *results, status = kernel(*batch.values())
    assert status.tolist() == [NOT_FINITE] * (small + large) + [1.0, 1.0]
    assert np.isnan(results[0][:-2]).all() and np.isnan(results[1][:-2]).all()
    assert (results[0][-2:] == 1.0).all() and (results[1][-2:] == 1.0).all()
    assert same_bits(results[2], batch["free"])
    for k in range(len(places)):
        single = kernel(*(x[k] for x in batch.values()))
        assert all_same_bits(single, tuple(x[k] for x in (*results, status)))


def test_large_numbers_are_finite():
    """The watch does not overflow: numbers near the largest are results like others."""
    schedule = watched(7, 40)
    system = {name: np.full(schedule.externals[name].shape, 1.7e308) for name in schedule.names("input")}
    system["code"] = np.array(0.0)
    for lanes in (2, 8):
        assert check(schedule, kernel_of(schedule, lanes), [system] * 3, shared=False) == [0.0] * 3


def test_operation_count():
    """Of one system, its parameters' included: every item of every call."""
    double = stage("double", lambda x: (x * 3.0,), [{"x": (2,)}], [("y",)])
    externals = {"x": External((6,), "parameter"), "y": External((6,), "output")}
    places = (4, 0, 2)
    group = Group(double, 3, {"x": Wire("x", places), "y": Wire("y", places)}, side_by_side=True)
    schedule = Schedule(externals, {}, {"double": group}, (Call("double", 0, (0, 1, 2)),), ())
    assert schedule.operation_count == 6
    assert kernel_of(schedule, 4).operation_count == 6
    assert schedule.names("output", "parameter") == ("x", "y")


@pytest.mark.parametrize("order", [(0, 1, 2, 3, 4), (4, 3, 2, 1, 0), (2, 0, 4, 1, 3)])
def test_handed_on(order):
    """Items one after the other hand a value on, in the order of the call."""
    fold = stage("fold", lambda m, s: (s * 10.0 + m,), [{"m": (1,), "s": (1,)}], [("s'",)])
    begin = stage("begin", lambda: (0.0,), [{}], [("s'",)])
    end = stage("end", lambda s: (s[0],), [{"s": (1,)}], [("sum",)])
    externals = {"m": External((5,), "input"), "sum": External((), "output")}
    internals = {"s": Internal(6, 1)}
    turns = [order.index(i) for i in range(5)]
    s, handed = Wire("s", tuple(turns)), Wire("s", tuple(turn + 1 for turn in turns))
    groups = {
        "begin": Group(begin, 1, {"s'": Wire("s", (0,))}, side_by_side=False),
        "fold": Group(fold, 5, {"m": Wire("m", (3, 1, 0, 4, 2)), "s": s, "s'": handed}, side_by_side=False),
        "end": Group(end, 1, {"s": Wire("s", (5,)), "sum": Wire("sum", (0,))}, side_by_side=False),
    }
    calls = (Call("begin", 0, (0,)), Call("fold", 0, order), Call("end", 0, (0,)))
    schedule = Schedule(externals, internals, groups, (), calls)
    digits = np.array([3.0, 1.0, 4.0, 1.0, 5.0])
    expected = float("".join(str(int(digits[(3, 1, 0, 4, 2)[i]])) for i in order))
    kernel = kernel_of(schedule, 4)
    assert kernel(digits)[0] == expected
    assert kernel(np.stack([digits] * 7))[0].tolist() == [expected] * 7
    assert interpret_schedule(schedule, {"m": digits})["sum"] == expected


def test_copies():
    """A batch reads consecutive numbers where they are; in another order they are copied, and for one system always."""
    doubled = stage("doubled", lambda x: (x * 2.0,), [{"x": (5,)}], [("y",)])
    handed = stage("handed", lambda y: (y[1:4], y[::-1]), [{"y": (5,)}], [("middle", "turned")])
    used = stage("used", lambda middle, turned: (middle - turned[:3],), [{"middle": (3,), "turned": (5,)}], [("z",)])
    externals = {"x": External((5,), "input"), "z": External((3,), "output")}
    internals = {"y": Internal(1, 5), "middle": Internal(1, 3), "turned": Internal(1, 5)}
    stages = {
        "doubled": (doubled, ["x", "y"]),
        "handed": (handed, ["y", "middle", "turned"]),
        "used": (used, ["middle", "turned", "z"]),
    }
    groups = {
        name: Group(made, 1, {port: Wire(port, (0,)) for port in ports}, side_by_side=False)
        for name, (made, ports) in stages.items()
    }
    calls = tuple(Call(name, 0, (0,)) for name in groups)
    schedule = Schedule(externals, internals, groups, (), calls)
    for layout, copied in ((Layout(schedule, 4), [3, 5]), (Layout(schedule, 4, systems=4), [0, 5])):
        assert [len(output.places) for output in layout.computed(calls[1]).outputs[:2]] == copied
    x = np.arange(35.0).reshape(7, 5)
    expected = 2.0 * (x[:, 1:4] - x[:, :1:-1])
    kernel = kernel_of(schedule, 4)
    assert np.array_equal(kernel(x)[0], expected) and np.array_equal(kernel(x[6])[0], expected[6])


def links(count: int) -> Schedule:
    """Return a chain of stages, each of which needs what the first and the one before it have computed."""
    made = stage("link", lambda y, x: (y * x + x,), [{"y": (5,), "x": (5,)}], [("z",)])
    externals = {"x": External((5,), "input"), "z": External((5,), "output")}
    names = ["x", *(f"y{k}" for k in range(1, count)), "z"]
    groups = {}
    for k, (before, after) in enumerate(pairwise(names)):
        wires = {"y": before, "x": "y1" if k > 1 else "x", "z": after}
        groups[f"link{k}"] = Group(made, 1, {port: Wire(array, (0,)) for port, array in wires.items()}, False)
    calls = tuple(Call(name, 0, (0,)) for name in groups)
    return Schedule(externals, {name: Internal(1, 5) for name in names[1:-1]}, groups, (), calls)


@pytest.mark.parametrize("systems", [1, 4])
def test_memory_is_used_again(systems):
    """A longer chain needs no more memory, and what the first of its stages computes stays until the last needs it."""
    assert Layout(links(20), 4, systems).total == Layout(links(5), 4, systems).total
    schedule, random_ = links(20), np.random.default_rng(0)
    check(schedule, kernel_of(schedule, 4), [{"x": random_.uniform(-1.0, 1.0, 5)} for _ in range(13)], shared=False)


def test_parameters_are_prepared_once():
    """Without `prepare` a bound kernel computes with the old ones."""
    made = stage("squares", lambda p, x: (p * p * x,), [{"p": (3,)}, {"x": (3,)}], [(), ("y",)])
    externals = {"x": External((3,), "input"), "p": External((3,), "parameter"), "y": External((3,), "output")}
    group = Group(made, 1, {name: Wire(name, (0,)) for name in externals}, side_by_side=False)
    schedule = Schedule(externals, {}, {"squares": group}, (Call("squares", 0, (0,)),), (Call("squares", 1, (0,)),))
    bound = kernel_of(schedule, 4).bind()
    bound.arrays["x"][:], bound.arrays["p"][:] = 1.0, 2.0
    bound.prepare()
    bound.run()
    assert bound.arrays["y"].tolist() == [4.0] * 3
    bound.arrays["p"][:], bound.arrays["x"][:] = 3.0, 5.0
    bound.run()
    assert bound.arrays["y"].tolist() == [20.0] * 3
    bound.prepare()
    bound.run()
    assert bound.arrays["y"].tolist() == [45.0] * 3
