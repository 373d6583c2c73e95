"""The text given to LLVM."""

import re

import numpy as np
import pytest
from hypothesis import given, settings

from holdfast.compiler.errors import CompileError
from holdfast.compiler.lowering import lowered
from holdfast.compiler.program import Program
from holdfast.compiler.targets import batch_module, cpu, single_module
from holdfast.compiler.trace import trace
from tests.compiler.programs import programs, schedule_of


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


def test_refused_text():
    """LLVM's own complaint comes through as ours."""
    with pytest.raises(CompileError, match="LLVM refuses"):
        cpu.Code("define nothing", "single")


def test_lanes():
    """Lanes are vectors; selections and comparisons too."""
    text = modules(trace(lambda x: (np.sqrt(x), (x[0] < x[1]).where(x[0], 2.0)), [(2,)]))[1]
    assert "@llvm.sqrt.v4f64" in text and "select <4 x i1>" in text and "fcmp olt <4 x double>" in text
