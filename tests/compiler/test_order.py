"""Programs in another order compute the same bits, and no order in use has more numbers live."""

import random
from itertools import pairwise

import numpy as np
import pytest
from benchmarks import cone_iteration
from benchmarks.bench.systems import make_system
from hypothesis import given, settings
from hypothesis import strategies as st

import holdfast as hf
from holdfast.compiler import order
from holdfast.compiler.cut import by_length
from holdfast.compiler.interpret import interpret
from holdfast.compiler.lowering import lowered
from holdfast.compiler.order import depth_first, is_crowded, ordered
from holdfast.compiler.program import Instruction, Output, Program
from holdfast.compiler.targets.split import LONGEST_PART
from tests.compiler.programs import NUMBERS, all_same_bits, programs

SEVEN = st.lists(NUMBERS, min_size=7, max_size=7)


def live_by_definition(program: Program) -> list[int]:
    """Return the numbers in use at each instruction: begun there or before, and an operand there or later."""
    first, found = program.input_size, []
    rows = list(enumerate(program.instructions))[first:]
    for k, _ in rows:
        count = 0
        for place, instruction in enumerate(program.instructions):
            users = [p for p, i in rows if place in i.args]
            begin = place if place >= first else min(users, default=0)
            count += instruction.kind != "constant" and begin <= k < max(users, default=-1)
        found.append(count)
    return found


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(programs(20))
def test_live_numbers(program):
    """They are what their definition counts."""
    program = lowered(program)
    assert program.live_numbers == live_by_definition(program)


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(programs(), SEVEN)
def test_bits(program, values):
    """Depth first, every instruction comes after its operands and keeps them, and results have the same bits."""
    program = lowered(program)
    arrays = [np.array(values[:3]), np.array(values[3:]).reshape(2, 2)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(order, "_REGISTERS", -1)  # every program is crowded
        patch.setattr(order, "min", lambda _, other, key: other, raising=False)  # and is reordered
        other = ordered(program)
    assert sorted(i.kind for i in other.instructions) == sorted(i.kind for i in program.instructions)
    assert all(a < place for place, i in enumerate(other.instructions) for a in i.args)
    assert other.input_size == program.input_size
    assert all_same_bits(interpret(other, *arrays, fused=False), interpret(program, *arrays, fused=False))


def columns(rows: int, count: int) -> Program:
    """Return sums of products that are computed product by product for all rows at once."""
    instructions = [Instruction("input") for _ in range(rows * count)]
    products = [[] for _ in range(rows)]
    for j in range(count):
        for i in range(rows):
            products[i].append(len(instructions))
            instructions.append(Instruction("sqrt", (i * count + j,)))
    results = []
    for row in products:
        for place in row[1:]:
            instructions.append(Instruction("add", (row[0] if place == row[1] else len(instructions) - 1, place)))
        results.append(len(instructions) - 1)
    return Program(((rows, count),), tuple(instructions), (Output((rows,), tuple(results)),))


def test_shorter_lives():
    """Terms that all wait until their sums are formed are computed one sum after the other instead."""
    program = columns(20, 10)
    found = ordered(program)
    assert max(program.live_numbers) == 200
    assert max(found.live_numbers) <= 2
    assert depth_first(found) == list(range(found.input_size, len(found.instructions)))
    x = np.random.default_rng(0).uniform(size=(20, 10))
    assert all_same_bits(interpret(found, x), interpret(program, x))


def test_what_is_not_crowded_stays():
    """A program whose numbers have room is left as it is."""
    program = columns(3, 10)
    assert not is_crowded(program)
    assert ordered(program) is program


def test_sample_computations():
    """In the parts of real computations, never more numbers are live on average, and in many fewer are."""
    forward = hf.compile(make_system(2, 7, 1).chain).forward_dynamics.calls.kernel.schedule
    stages = {g.stage for schedule in (forward, cone_iteration.schedule()) for g in schedule.groups.values()}
    phases = [phase for stage in stages for phase in stage.pieces.programs]
    parts = [part for phase in phases for part in by_length(phase, LONGEST_PART).programs]
    pairs = [(sum(part.live_numbers), sum(ordered(part).live_numbers)) for part in parts]
    assert all(after <= before for before, after in pairs)
    assert sum(after < before for before, after in pairs) >= 4


def test_deep_programs():
    """The order is found without recursion."""
    random.seed(0)
    instructions = [Instruction("input"), Instruction("input")]
    instructions += [Instruction("add", (k + 1, random.randrange(k + 2))) for k in range(20_000)]
    program = Program(((2,),), tuple(instructions), (Output((), (len(instructions) - 1,)),))
    found = depth_first(program)
    assert sorted(found) == list(range(2, len(instructions)))
    assert all(b == a + 1 for a, b in pairwise(found))  # every instruction needs the one before
