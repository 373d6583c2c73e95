"""Programs lowered, in pieces and in phases compute the same bits, and remember no more than they must."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from holdfast.compiler.cut import Pieces, by_length, by_phase
from holdfast.compiler.interpret import interpret
from holdfast.compiler.lowering import expand, fuse, lowered
from holdfast.compiler.program import Program
from holdfast.compiler.trace import trace
from tests.compiler.programs import NUMBERS, all_same_bits, programs, stage

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


X = np.array([1.0 + 2.0**-30, 1.0 + 2.0**-29, 3.0])


def fused(function):
    """Return the fused program of a function on three numbers."""
    return fuse(trace(function, [(3,)]))


def test_forms():
    """ab + c, ab - c, c - ab, and a constant factor: one operation, rounded once."""
    exact = float(2.0**-30 * 2.0**-29)
    for function in (
        lambda x: (x[0] * x[1] + (-1.0 - 3 * 2.0**-30),),
        lambda x: (x[0] * x[1] - (1.0 + 3 * 2.0**-30),),
    ):
        assert fused(function).counts["fma"] == 1
        assert interpret(trace(function, [(3,)]), X)[0] == exact
    assert fused(lambda x: (x[2] - x[0] * x[1],)).counts == {"fma": 1, "negate": 1}
    assert fused(lambda x: (x[2] - 0.3 * x[1],)).counts == {"fma": 1}
    assert fused(lambda x: (x[0] * x[1] - x[2],)).counts == {"fma": 1, "negate": 1}


def test_only_products_used_once():
    """A product that something else needs too stays, and so does a result."""
    assert fused(lambda x: (x[0] * x[1] + x[2], x[0] * x[1] - x[2])).counts["fma"] == 0
    assert fused(lambda x: (x[0] * x[1] + x[2], x[0] * x[1])).counts["fma"] == 0
    assert fused(lambda x: ((x[0] * x[1]) + (x[0] * x[1]),)).counts["fma"] == 0


def test_the_later_product():
    """Of two products the later goes into the sum, so the bits are fixed."""
    program = fused(lambda x: (x[0] * x[1] + x[1] * x[2],))
    assert program.counts == {"multiply": 1, "fma": 1}
    multiply = next(i for i in program.instructions if i.kind == "multiply")
    assert multiply.args == (0, 1)


@settings(max_examples=50, deadline=None)
@given(programs())
def test_repeatable(program):
    """Lowering twice changes nothing, nor does it lose an operand's order or a result."""
    once = lowered(program)
    assert lowered(once) == once
    assert fuse(expand(program)) == once
    assert all(a < place for place, i in enumerate(once.instructions) for a in i.args)
    x = (np.array([0.5, -1.25, 3.0]), np.array([[2.0, -0.0], [1e-3, 7.0]]))
    assert all_same_bits(interpret(program, *x), interpret(once, *x))


def test_small_error():
    """Fused and unfused programs differ by rounding only."""
    program = trace(lambda x: (np.sin(x) @ x + np.cos(x) * x[0] - x / 3.0,), [(3,)])
    (a,), (b,) = interpret(program, X), interpret(program, X, fused=False)
    expected = np.sin(X) @ X + np.cos(X) * X[0] - X / 3
    assert np.abs(a - expected).max() < 1e-15 and np.abs(b - expected).max() < 2e-15
    assert math.isfinite(a[0])


A, B, C = np.array([0.5, -1.25]), np.array([3.0]), np.array([[1.0, 2.0], [-0.5, 4.0]])


def function(a, b, c):
    """What is known of a comes first, what b adds next."""
    s = np.sin(a)
    t = s * b[0]
    return s @ a, 2.0, c @ t, t


def test_stage():
    """Ports by phase; each piece has what was known by then and the memories before it."""
    made = stage("three", function, [{"a": (2,)}, {"b": (1,)}, {"c": (2, 2)}], [("aa", "two"), (), ("ct", "t")])
    assert made.input_ports == ("a", "b", "c")
    assert made.outputs == ({"aa": (), "two": ()}, {}, {"ct": (2,), "t": (2,)})
    assert made.shapes == {"a": (2,), "b": (1,), "c": (2, 2), "aa": (), "two": (), "ct": (2,), "t": (2,)}
    assert [made.size(port) for port in ("a", "c", "aa")] == [2, 4, 1]
    first, second, third = made.pieces.programs
    nothing = np.full(1, np.nan), np.full((2, 2), np.nan)
    aa, two, sines = interpret(first, A, *nothing, fused=False)
    (t,) = interpret(second, A, B, nothing[1], sines, fused=False)
    ct, same, none = interpret(third, np.full(2, np.nan), nothing[0], C, sines, t, fused=False)
    expected = interpret(made.program, A, B, C, fused=False)
    for found, x in zip((aa, two, ct, same), expected, strict=True):
        assert np.array_equal(found, x)
    np.testing.assert_allclose(ct, C @ (np.sin(A) * B), rtol=1e-14)
    assert sines.shape == t.shape == (2,) and none.shape == (0,)
