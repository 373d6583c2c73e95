"""The text given to LLVM, the processors that it is compiled for, and the transposition of rows into lanes."""

import ctypes
import functools
import gc
import re
import threading
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings

import holdfast
from holdfast.compiler.errors import CompileError
from holdfast.compiler.interpret import interpret
from holdfast.compiler.kernel import aligned
from holdfast.compiler.lowering import lowered
from holdfast.compiler.program import Program
from holdfast.compiler.targets import batch_module, cpu, single_module
from holdfast.compiler.targets.llvm.transposition import transpositions
from holdfast.compiler.trace import trace
from tests.compiler.programs import all_same_bits, compile_program, programs, schedule_of, stage
from tests.processors import levels


def modules(program: Program, lanes: int = 4) -> tuple[str, str]:
    """Return the texts of both modules of a program."""
    schedule = schedule_of(lowered(program))
    return single_module(schedule, lanes)[0], batch_module(schedule, lanes)[0]


FLAGS = re.compile(r"\b(fast|reassoc|contract|arcp|afn|nnan|ninf|nsz|unsafe-fp-math|fmuladd)\b")


@settings(max_examples=50, deadline=None)
@given(programs())
def test_no_fast_math(program):
    """No flag that would let LLVM change a bit, in any module."""
    for text in modules(program):
        assert not FLAGS.search(text)


def test_constants_by_bits():
    """Constants are written as bits, not rounded decimals."""
    text = modules(trace(lambda x: (x * 0.1, x + -0.0), [()]))[0]
    assert "0x3FB999999999999A" in text


@pytest.mark.skipif("codemodel" not in cpu._NEAR, reason="constants lie beside the code under Linux on x86-64 only")
@pytest.mark.skipif("x86-64-v3" not in levels(True), reason="this processor does not run code for x86-64-v3")
def test_constants_are_operands():
    """Instructions name constants; addresses are loaded first only if a module names what lies elsewhere."""
    text = modules(trace(lambda x: (x * 0.1 + 0.7, 0.3 - x), [(4,)]))[1]
    with cpu.made_for(cpu.level("x86-64-v3")):
        near = cpu.assembly(text)
        far = cpu.assembly(f"{text}\ndeclare void @elsewhere()")
    assert ".LCPI" in near and not re.search(r"\$\.LCPI", near)
    assert re.search(r"movabsq\s+\$\.LCPI", far)


def test_refused_text():
    """LLVM's own complaint comes through as ours."""
    with pytest.raises(CompileError, match="LLVM refuses"):
        cpu.Code("define nothing", "single")


def test_lanes():
    """Lanes are vectors; selections and comparisons too."""
    text = modules(trace(lambda x: (np.sqrt(x), (x[0] < x[1]).where(x[0], 2.0)), [(2,)]))[1]
    assert "@llvm.sqrt.v4f64" in text and "select <4 x i1>" in text and "fcmp olt <4 x double>" in text


LANES_OF = {"x86-64-v2": 2, "x86-64-v3": 4, "x86-64-v4": 8}
RUNNABLE = [*levels(fma=False), *levels(fma=True)]
X = (np.random.default_rng(0).normal(size=5),)


def function(x):
    """Return sums of products, a quotient, and a sine with its reduction."""
    return x @ x, np.sin(x), x[0] * x[1] - x[2] / x[3]


@pytest.mark.parametrize("how", ["full", "quick"])
@pytest.mark.parametrize("level", RUNNABLE)
def test_bits(level, how, monkeypatch):
    """Alone, in lanes and in tails the interpreter's bits; without an instruction for fma the C library's serves."""
    monkeypatch.setenv("HOLDFAST_CPU", level)
    monkeypatch.setenv("HOLDFAST_COMPILE", how)
    assert cpu.lanes() == LANES_OF[level] and cpu.has_fma() == (level != "x86-64-v2")
    program = trace(function, [(5,)])
    for fused in (True, False):
        kernel = compile_program(program, fused)
        assert kernel.lanes == LANES_OF[level]
        expected = interpret(program, *X, fused=fused)
        assert all_same_bits(kernel(*X), expected)
        batch = kernel(np.stack([X[0]] * 11))
        for k in (0, 7, 10):
            assert all_same_bits(tuple(x[k] for x in batch), expected)


def test_products_are_not_fused_without_fma(monkeypatch):
    """A stage calls no library for its sums of products; only sines, which need it, keep their fma."""
    for level, fused in (("x86-64-v2", 0), ("x86-64-v3", 4)):
        if level in RUNNABLE:
            monkeypatch.setenv("HOLDFAST_CPU", level)
            made = stage("text", lambda x: (x @ x,), [{"x": (5,)}], [("y",)])
            assert made.program.counts["fma"] == fused


@pytest.mark.parametrize("level", RUNNABLE)
def test_cache(level, monkeypatch, tmp_path):
    """Code for another processor is another entry."""
    monkeypatch.setenv("HOLDFAST_CACHE", str(tmp_path / "cache"))
    made = []
    compiled = cpu._compiled
    monkeypatch.setattr(cpu, "_compiled", lambda text, *more: made.append(text) or compiled(text, *more))
    source = "define i64 @run() {\n  ret i64 42\n}"
    for name, count in (("host", 1), (level, 2), (level, 2), ("host", 2), ("", 2)):
        monkeypatch.setenv("HOLDFAST_CPU", name)
        cpu.Code(source, "run", key="one")
        assert len(made) == len(list((tmp_path / "cache").iterdir())) == count


@pytest.mark.parametrize("name", ["x86-64-v5", "haswell", "X86-64-V3", "native", " "])
def test_unknown(name, monkeypatch):
    """The message lists what there is, and what this machine can run."""
    monkeypatch.setenv("HOLDFAST_CPU", name)
    expected = f"expected one of host, x86-64-v2, x86-64-v3, x86-64-v4, got {name!r}. Available on this machine: host"
    with pytest.raises(CompileError, match=re.escape(expected)):
        compile_program(trace(function, [(5,)]))


def test_compiled_quickly(monkeypatch, tmp_path):
    """Other code under another key, and nothing but `quick` and `full`."""
    monkeypatch.setenv("HOLDFAST_CACHE", str(tmp_path / "cache"))
    source = "define i64 @run() {\n  ret i64 42\n}"
    for how, count in (("full", 1), ("quick", 2), ("", 2)):
        monkeypatch.setenv("HOLDFAST_COMPILE", how)
        cpu.Code(source, "run", key="one")
        assert len(list((tmp_path / "cache").iterdir())) == count
    monkeypatch.setenv("HOLDFAST_COMPILE", "fast")
    with pytest.raises(CompileError, match="HOLDFAST_COMPILE: expected full or quick, got 'fast'"):
        cpu.Code(source, "run", key="one")


def test_refused_rather_than_an_illegal_instruction(monkeypatch):
    """A level that the processor does not reach is refused before any code runs, with what it lacks."""
    monkeypatch.setattr(cpu, "features", lambda: frozenset(cpu.X86_LEVELS["x86-64-v3"]) - {"bmi2", "fma"})
    cpu._target.cache_clear()
    try:
        monkeypatch.setenv("HOLDFAST_CPU", "x86-64-v3")
        expected = "HOLDFAST_CPU: x86-64-v3 needs bmi2, fma, which this processor lacks. Available: host, x86-64-v2"
        with pytest.raises(CompileError, match=re.escape(expected)):
            compile_program(trace(function, [(5,)]))
    finally:
        cpu._target.cache_clear()


def test_one_door():
    """What belongs to one target is reached through `holdfast.compiler.targets` alone."""
    root = Path(holdfast.__file__).parent
    inside = root / "compiler" / "targets"
    others = [path for path in root.rglob("*.py") if inside not in path.parents]
    assert others and not [path for path in others if "compiler.targets." in path.read_text(encoding="utf-8")]


SIZES = range(1, 21)
LANES = [2, 4, 8]
UNTOUCHED = -7.0
_MOVE = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64, ctypes.c_int64, ctypes.c_void_p)


@functools.cache
def code(lanes: int) -> cpu.Code:
    """Return all functions for so many lanes, under names that can be called."""
    names = [f"{way}.{size}" for way in ("to_lanes", "from_lanes", "checked", "streamed") for size in SIZES]
    lines = transpositions([(name.split(".")[0], int(name.split(".")[1])) for name in names], lanes)
    given = "ptr %rows, i64 %stride, i64 %first, i64 %last, ptr %lanes"
    for name in names:
        lines.append(f"define void @call.{name}({given}) {{")
        if name.startswith(("checked", "streamed")):  # the sum is written behind the area
            V, behind = f"<{lanes} x double>", -(-int(name.split(".")[1]) // lanes) * lanes * lanes
            lines.append(f"  %sum = call {V} @{name}({given})")
            lines.append(f"  %at = getelementptr double, ptr %lanes, i64 {behind}")
            lines.append(f"  store {V} %sum, ptr %at, align 8")
        else:
            lines.append(f"  call void @{name}({given})")
        lines += ["  ret void", "}"]
    return cpu.Code("\n".join(lines), *(f"call.{name}" for name in names))


def move(way: str, size: int, lanes: int, rows: np.ndarray, stride: int, first: int, last: int, area: np.ndarray):
    """Call one of them."""
    function = _MOVE(code(lanes).addresses[f"call.{way}.{size}"])
    function(rows.ctypes.data, stride, first, last, area.ctypes.data)


def numbers(rows: int, stride: int) -> np.ndarray:
    """Return rows of different numbers, at an address that is a multiple of eight bytes and no more."""
    block = aligned(rows * stride + 1)[1:]
    block[:] = np.arange(1.0, rows * stride + 1.0)
    return block.reshape(rows, stride)


def area_of(size: int, lanes: int) -> np.ndarray:
    """Return what a batch has for an array in lanes, and one square behind it."""
    area = aligned((-(-size // lanes) + 1) * lanes * lanes)
    area[:] = UNTOUCHED
    return area.reshape(-1, lanes)


@pytest.mark.parametrize("lanes", LANES)
def test_to_lanes(lanes):
    """Lane j is row min(first + j, last), for every number of rows left and for rows apart."""
    for size, stride in [(size, size + more) for size in SIZES for more in (0, 3)]:
        for left in range(1, lanes + 2):
            rows = numbers(left + 2, stride)
            area = area_of(size, lanes)
            move("to_lanes", size, lanes, rows, stride, 2, left + 1, area)
            expected = rows[np.minimum(2 + np.arange(lanes), left + 1), :size].T
            assert np.array_equal(area[:size], expected), (size, stride, left)
            assert (area[-(-size // lanes) * lanes :] == UNTOUCHED).all(), (size, stride, left)


@pytest.mark.parametrize("lanes", LANES)
def test_one_row_for_all(lanes):
    """Stride 0: a parameter that all systems share."""
    for size in SIZES:
        rows, area = numbers(1, size), area_of(size, lanes)
        move("to_lanes", size, lanes, rows, 0, 3, 50, area)
        assert np.array_equal(area[:size], np.repeat(rows.T, lanes, axis=1)), size


@pytest.mark.parametrize("lanes", LANES)
def test_from_lanes(lanes):
    """Back again, over these rows and nothing else; lanes beyond the last row hold its numbers once more."""
    for size, stride in [(size, size + more) for size in SIZES for more in (0, 3)]:
        for left in range(1, lanes + 2):
            rows = aligned((left + 3) * stride + 1)[1:].reshape(-1, stride)
            rows[:] = UNTOUCHED
            used, area = min(left, lanes), area_of(size, lanes)
            values = np.random.default_rng(left).normal(size=(used, size))
            area[:size] = values[np.minimum(np.arange(lanes), used - 1)].T
            move("from_lanes", size, lanes, rows, stride, 2, left + 1, area)
            expected = np.full_like(rows, UNTOUCHED)
            expected[2 : 2 + used, :size] = values
            assert np.array_equal(rows, expected), (size, stride, left)


@pytest.mark.parametrize("lanes", LANES)
@pytest.mark.parametrize("way", ["checked", "streamed"])
def test_sums(way, lanes):
    """Rows are written as without sums, which are 0 where all numbers are finite; streams fill up the register."""
    for size in SIZES:
        filled = -(-size // lanes) * lanes
        rows, area = aligned((lanes + 2) * filled).reshape(-1, filled), area_of(size, lanes)
        values = np.random.default_rng(size).normal(size=(lanes, size))
        for bad, number in ((None, 0.0), (0, np.nan), (lanes - 1, np.inf), (1, -np.inf)):
            for column in range(size):
                rows[:], given = UNTOUCHED, values.copy()
                if bad is not None:
                    given[bad, column] = number
                area[:size] = given.T
                with np.errstate(invalid="ignore"):
                    move(way, size, lanes, rows, filled, 1, lanes, area)
                assert np.array_equal(rows[1:-1, :size], given, equal_nan=True), (size, bad, column)
                assert (rows[[0, -1]] == UNTOUCHED).all(), (size, bad, column)
                assert (rows[1:-1, size:] == (0.0 if way == "streamed" else UNTOUCHED)).all(), (size, bad, column)
                odd = np.isnan(area[filled])
                assert np.array_equal(odd, np.arange(lanes) == bad), (size, bad, column)
                assert not area[filled][~odd].any(), (size, bad, column)


@pytest.mark.parametrize("lanes", LANES)
def test_no_bit_is_lost(lanes):
    """NaN with its payload, infinities and zeros with their signs are moved, not computed with."""
    size = 3
    bits = np.array([0x7FF8000000000123, 0xFFF0000000000000, 0x8000000000000000], dtype=np.uint64)
    rows, area, back = aligned(size), area_of(size, lanes), aligned(size * lanes)
    rows.view(np.uint64)[:] = bits
    move("to_lanes", size, lanes, rows, 0, 0, lanes, area)
    move("from_lanes", size, lanes, back, size, 0, lanes - 1, area)
    assert np.array_equal(back.view(np.uint64), np.tile(bits, lanes))


def test_none():
    """Arrays without numbers need no function: a module has those that are asked for, once."""
    assert not [line for line in transpositions([], 4) if line.startswith("define")]
    asked = [("to_lanes", 3), ("to_lanes", 3), ("from_lanes", 9)]
    assert len([line for line in transpositions(asked, 4) if line.startswith("define")]) == 2


def test_paused():
    """Off within, also within itself; on again at the end, and after an error."""
    assert gc.isenabled()
    with cpu.collector_paused():
        with cpu.collector_paused():
            assert not gc.isenabled()
        assert not gc.isenabled()
    assert gc.isenabled()
    with pytest.raises(ZeroDivisionError), cpu.collector_paused():
        1 / 0  # noqa: B018
    assert gc.isenabled()


def test_who_turned_it_off_keeps_it_off():
    """It is not turned on for somebody who did not want it."""
    gc.disable()
    try:
        with cpu.collector_paused():
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()


def test_threads():
    """The last one out turns it on."""
    inside, leave = threading.Barrier(2), threading.Event()

    def stay():
        with cpu.collector_paused():
            inside.wait()
            leave.wait()

    thread = threading.Thread(target=stay)
    thread.start()
    with cpu.collector_paused():
        inside.wait()
    assert not gc.isenabled()
    leave.set()
    thread.join()
    assert gc.isenabled()


def test_while_a_text_is_made():
    """That is when it is off, and not while LLVM works."""
    seen = []

    def source():
        seen.append(gc.isenabled())
        return "define i64 @run() {\n  ret i64 1\n}", {}

    cpu.Code(source, "run")
    assert seen == [False] and gc.isenabled()
