"""HOLDFAST_CPU and HOLDFAST_COMPILE: what code is made for and how, and what is refused."""

import re
from pathlib import Path

import numpy as np
import pytest

import holdfast
from holdfast.compiler.errors import CompileError
from holdfast.compiler.interpret import interpret
from holdfast.compiler.targets import cpu
from holdfast.compiler.trace import trace
from tests.compiler.programs import all_same_bits, compile_program
from tests.compiler.schedules import stage
from tests.processors import levels

LANES = {"x86-64-v2": 2, "x86-64-v3": 4, "x86-64-v4": 8}
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
    assert cpu.lanes() == LANES[level] and cpu.has_fma() == (level != "x86-64-v2")
    program = trace(function, [(5,)])
    for fused in (True, False):
        kernel = compile_program(program, fused)
        assert kernel.lanes == LANES[level]
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
