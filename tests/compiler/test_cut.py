"""Programs in pieces compute the same bits, and remember no more than they must."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from holdfast.compiler.cut import Pieces, by_length, by_phase
from holdfast.compiler.interpret import interpret
from holdfast.compiler.lowering import lowered
from holdfast.compiler.program import Program
from holdfast.compiler.trace import trace
from tests.compiler.programs import NUMBERS, all_same_bits, programs

FREE = {"constant", "negate", "absolute", "less", "less_equal"}
SEVEN = st.lists(NUMBERS, min_size=7, max_size=7)


def arrays(values: list[float]) -> list[np.ndarray]:
    """Return the inputs of a random program."""
    return [np.array(values[:3]), np.array(values[3:]).reshape(2, 2)]


def run(pieces: Pieces, inputs: list[list[np.ndarray]]) -> list[list[np.ndarray]]:
    """Return each piece's results, run with its inputs and the memories before it."""
    memories, results = [], []
    for piece, given_ in zip(pieces.programs, inputs, strict=True):
        *found, memory = interpret(piece, *given_, *memories, fused=False)
        memories.append(memory)
        results.append(found)
    assert pieces.memory == tuple(m.size for m in memories)
    return results


def check_memory(pieces: Pieces) -> None:
    """Nothing is kept that is free to make or was there before; everything kept is used later."""
    starts = np.cumsum([0, *pieces.memory]).tolist()
    first = pieces.programs[0].input_size
    used: set[int] = set()
    for k, piece in enumerate(pieces.programs):
        assert piece.input_size == first + starts[k]
        for place in piece.outputs[-1].places:
            assert piece.instructions[place].kind not in {"input", *FREE}
        assert len(set(piece.outputs[-1].places)) == pieces.memory[k]
        used |= {a for i in piece.instructions for a in i.args if first <= a < piece.input_size}
        used |= {p for output in piece.outputs for p in output.places if first <= p < piece.input_size}
    assert used == set(range(first, first + starts[-1]))


def check_order(pieces: Pieces) -> None:
    """Operands come before their uses, and nothing is computed that neither a result nor memory needs."""
    for piece in pieces.programs:
        assert all(a < place for place, i in enumerate(piece.instructions) for a in i.args)
        needed = {p for output in piece.outputs for p in output.places if p >= 0}
        for place in reversed(range(piece.input_size, len(piece.instructions))):
            assert place in needed
            needed |= set(piece.instructions[place].args)


@settings(max_examples=60, deadline=None)
@given(programs(), st.integers(1, 50), SEVEN)
def test_by_length(program, length, values):
    """Every entry is written by one piece, and is the whole program's."""
    program = lowered(program)
    pieces = by_length(program, length)
    inputs = arrays(values)
    found = [np.full(output.shape, math.nan) for output in program.outputs]
    written = [np.zeros(output.shape, dtype=int) for output in program.outputs]
    results = run(pieces, [inputs] * len(pieces.programs))
    for piece, result in zip(pieces.programs, results, strict=True):
        for k, output in enumerate(piece.outputs[:-1]):
            own = [e for e, place in enumerate(output.places) if place >= 0]
            found[k].reshape(-1)[own] = result[k].reshape(-1)[own]
            written[k].reshape(-1)[own] += 1
        assert sum(n for kind, n in piece.counts.items() if kind not in FREE) <= length
    assert all((count == 1).all() for count in written)
    assert all_same_bits(tuple(found), interpret(program, *inputs, fused=False))
    check_memory(pieces)
    check_order(pieces)


def phases_of(program: Program, input_phases: list[int]) -> list[int]:
    """Return when each output can be computed."""
    sizes = [math.prod(shape) for shape in program.input_shapes]
    known = [phase for phase, size in zip(input_phases, sizes, strict=True) for _ in range(size)]
    for kind, args, _ in program.instructions[program.input_size :]:
        known.append(max((known[a] for a in args), default=0) if kind != "constant" else 0)
    return [max((known[p] for p in output.places), default=0) for output in program.outputs]


@settings(max_examples=60, deadline=None)
@given(programs(), st.lists(st.integers(0, 3), min_size=2, max_size=2), st.integers(0, 3), SEVEN)
def test_by_phase(program, input_phases, late, values):
    """Each phase runs without the inputs of later ones, and tells its results as early as asked for."""
    program = lowered(program)
    phases = phases_of(program, input_phases)
    phases[0] = max(phases[0], late)
    phases[1] = max(phases)
    counts = [phases.count(k) for k in range(4)]
    pieces = by_phase(program, input_phases, counts)
    inputs = arrays(values)
    unknown = [np.full(x.shape, math.nan) for x in inputs]
    so_far = [[x if p <= k else u for x, u, p in zip(inputs, unknown, input_phases, strict=True)] for k in range(4)]
    results = run(pieces, so_far)
    assert [len(found) for found in results] == counts
    assert all_same_bits(tuple(x for found in results for x in found), interpret(program, *inputs, fused=False))
    check_memory(pieces)
    check_order(pieces)


def test_nothing_is_computed_twice():
    """Each operation is in one piece: as early as its inputs allow."""
    function = lambda a, b: (np.sqrt(a) + a[0] * b, np.sqrt(a) @ b)  # noqa: E731
    program = trace(function, [(3,), (3,)])
    early, late = by_phase(program, [0, 1], [0, 2]).programs
    assert early.counts == {"sqrt": 3}
    assert early.counts + late.counts == program.counts


def test_signs_and_truths_are_made_again():
    """What the later phase needs of a sign, a size or a comparison is the number below it."""
    function = lambda a, b: ((a[0] * a[1] < 2.0).where(b[0], -(a[0] * a[1])) / abs(a[1]) + 3.0,)  # noqa: E731
    pieces = by_phase(trace(function, [(2,), (1,)]), [0, 1], [0, 1])
    assert pieces.memory == (1, 0)
    assert pieces.programs[0].counts == {"multiply": 1}
    assert pieces.programs[1].counts == {"less": 1, "negate": 1, "select": 1, "absolute": 1, "divide": 1, "add": 1}


def test_results_that_are_inputs_or_constants():
    """They need no memory, in whatever phase or piece they are asked for."""
    program = trace(lambda a, b: (a, -a, 2.5, b), [(2,), (2,)])
    assert by_phase(program, [0, 1], [1, 3]).memory == (0, 0)
    assert by_phase(program, [0, 0], [0, 4]).memory == (0, 0)
    assert by_length(program, 1).memory[-1] == 0


@pytest.mark.parametrize("length", [1, 7, 1000, 10**6])
def test_long_programs(length):
    """A long chain keeps one number a piece, whatever the length of the pieces."""

    def function(x):
        y = x[0]
        for _ in range(500):
            y = y / (1.25 + y * y)
        return (y,)

    program = trace(function, [(1,)])
    pieces = by_length(program, length)
    assert len(pieces.programs) == -(-(len(program.instructions) - 1) // length)
    assert max(pieces.memory) <= 2
    results = run(pieces, [[np.array([0.7])]] * len(pieces.programs))
    assert all_same_bits((results[-1][0],), interpret(program, np.array([0.7]), fused=False))
