"""What is traced: IEEE arithmetic, constants, nodes, the graph's identities, programs of functions."""

import itertools
import math
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from holdfast.compiler import arithmetic
from holdfast.compiler.constant import Constant, constants
from holdfast.compiler.errors import CompileError
from holdfast.compiler.graph import Graph
from holdfast.compiler.interpret import interpret
from holdfast.compiler.node import Node
from holdfast.compiler.trace import trace
from holdfast.spatial import scalar
from holdfast.spatial.scalar import maximum, select, where
from holdfast.spatial.vector import dot, product

IDENTITIES = {
    "x * 0": lambda x, y: (x * 0, 0.0),
    "0 * x": lambda x, y: (0.0 * x, 0.0),
    "x * 1": lambda x, y: (1.0 * x, x),
    "x * -1": lambda x, y: (x * -1, -x),
    "x + 0": lambda x, y: (0 + x, x),
    "x - 0": lambda x, y: (x - 0.0, x),
    "0 - x": lambda x, y: (0.0 - x, -x),
    "x - x": lambda x, y: (x - x, 0.0),
    "--x": lambda x, y: (-1.0 * -x, x),
    "0 / x": lambda x, y: (0.0 / x, 0.0),
    "x / 1": lambda x, y: (x / 1, x),
    "x / 4": lambda x, y: (x / 4, x * 0.25),
    "x + y": lambda x, y: (x + y, y + x),
    "x * y": lambda x, y: (x * y, y * x),
    "x + -y": lambda x, y: (x + -y, x - y),
    "-x + y": lambda x, y: (-x + y, y - x),
    "x - -y": lambda x, y: (x - -y, y + x),
    "-x - y": lambda x, y: (-x - y, -(x + y)),
    "-x * y": lambda x, y: (-x * y, -(y * x)),
    "-x * -y": lambda x, y: (-x * -y, x * y),
    "-2 x": lambda x, y: (-2.0 * x, -(x * 2.0)),
    "z - 2x": lambda x, y: (y + -2.0 * x, y - 2.0 * x),
    "-x / y": lambda x, y: (-x / y, -(x / y)),
    "x / -y": lambda x, y: (x / -y, -(x / y)),
    "x - 2": lambda x, y: (x - 2.0, x + -2.0),
    "y - x after x - y": lambda x, y: (-(x - y), y - x),
    "|-x|": lambda x, y: (abs(-x), abs(x)),
    "||x||": lambda x, y: (abs(abs(x)), abs(x)),
    "where(c, x, x)": lambda x, y: ((x < y).where(x, x), x),
    "where(c, 1, 1)": lambda x, y: ((x < y).where(1.0, 1), 1.0),
    "x < x": lambda x, y: (x < x, False),
    "x > y": lambda x, y: (x > y, y < x),
    "fma(x, y, 0)": lambda x, y: (x.fma(y, 0.0), x * y),
    "fma(x, 1, y)": lambda x, y: (x.fma(1.0, y), x + y),
    "fma(x, -1, y)": lambda x, y: (x.fma(-1.0, y), y - x),
    "fma(x, 0, y)": lambda x, y: (x.fma(0.0, y), y),
    "fma(y, x, 1)": lambda x, y: (y.fma(x, 1.0), x.fma(y, 1.0)),
}


@pytest.mark.parametrize("name", IDENTITIES)
def test_identities(name):
    """Both sides are one node, or one number."""
    graph = Graph()
    x, y = graph.input(), graph.input()
    left, right = IDENTITIES[name](x, y)
    if isinstance(left, float | bool):
        assert type(left) is type(right) and left == right
    else:
        assert left is right


def test_what_stays():
    """Operations that round are neither merged nor reordered."""
    graph = Graph()
    x, y, z = (graph.input() for _ in range(3))
    assert (x + y) + z is not x + (y + z)
    assert x / 3.0 is not x * (1.0 / 3.0)
    assert (x * 3.0) / 3.0 is not x
    assert (x + 0.1) - 0.1 is not x


def test_constants():
    """Numbers are folded as IEEE says; 0.0 and -0.0 are two constants."""
    graph = Graph()
    assert graph.apply("divide", 1.0, 0.0) == np.inf
    assert graph.apply("fma", 3.0, 4.0, 5.0) == 17.0
    assert graph.constant(0.0) is graph.constant(0.0)
    assert graph.constant(0.0) is not graph.constant(-0.0)


def nodes(count: int) -> np.ndarray:
    """Return an array of new inputs of one graph."""
    graph = Graph()
    return np.array([graph.input() for _ in range(count)])


def test_arrays_of_nodes():
    """NumPy works element by element, whatever stands on the left."""
    x = nodes(3)
    assert x.dtype == object
    for result in (x[0] * np.ones(3) * 2.0, np.ones(3) * x[0] * 2.0, x * 2.0, np.float64(2.0) * x, x + np.arange(1, 4)):
        assert isinstance(result, np.ndarray) and result.shape == (3,)
    assert isinstance(np.float64(2.0) * x[0], Node)
    assert np.float64(2.0) * x[0] is x[0] * 2
    assert (np.float64(2.0) < x[0]) is (x[0] > 2.0)
    assert (x @ x) is x[0] * x[0] + x[1] * x[1] + x[2] * x[2]
    assert np.sqrt(x)[1] is x[1].sqrt() and np.sin(x)[2] is x[2].sin()
    assert len({x[0], x[1], x[0]}) == 2


def test_powers():
    """Integer powers are products."""
    (x,) = nodes(1)
    assert x**0 == 1.0 and x**1 is x and x**2 is x * x
    assert x**5 is (x * x) * (x * x) * x
    assert x**-1 is 1.0 / x
    with pytest.raises(CompileError, match="integer power"):
        x**0.5


def test_where():
    """The vocabulary's `where`, `maximum` and `select` on nodes."""
    x = nodes(2)
    assert maximum(x[0], x[1]) is (x[0] > x[1]).where(x[0], x[1])
    assert where(x[0] < x[1], 2.0, 2.0) == 2.0
    assert select(x[0] < 1.0, x, np.zeros(2)).shape == (2,)
    with pytest.raises(CompileError, match="expected a comparison"):
        where(x[0], 1.0, 2.0)
    with pytest.raises(CompileError, match="expected a number"):
        (x[0] < 1.0).where(np.ones(2), 0.0)
    with pytest.raises(CompileError, match="try where"):
        (x[0] < 1.0) + 1.0


def a_branch(x):
    return (1.0 if x[0] > 0 else 2.0,)  # wrong: branch


def a_sort(x):
    return (max(x[0], x[1]),)  # wrong: max


def a_float(x):
    return (math.sin(x[0]),)  # wrong: math.sin


def an_array(x):
    out = np.zeros(2)
    out[0] = x[0]  # wrong: float array
    return (out,)


def an_integer(x):
    return (int(x[0]),)  # wrong: int


def an_index(x):
    return ([1.0, 2.0][x[0]],)  # wrong: index


def an_equality(x):
    return (1.0 if x[0] == x[1] else 2.0,)  # wrong: ==


def a_membership(x):
    return (x[1] in [x[0]],)  # wrong: in


def an_inverse(x):
    return (np.linalg.inv(x[0] * np.eye(2)),)  # wrong: np.linalg.inv


def a_floor(x):
    return (x[0] // 2.0,)  # wrong: //


def a_write(x):
    x[0] = 1.0  # wrong: write
    return (x,)


def an_argmax(x):
    return (x[np.argmax(x)],)  # wrong: argmax


WRONG = [a_branch, a_sort, a_float, an_array, an_integer, an_index, an_equality, a_membership]
WRONG += [an_inverse, a_floor, a_write, an_argmax]


@pytest.mark.parametrize("function", WRONG)
def test_misuse_names_the_line(function):
    """What would silently bake one value into the program is refused, with file, line and source."""
    source = Path(__file__).read_text().splitlines()
    first = function.__code__.co_firstlineno
    line = next(n for n in range(first, first + 5) if "# wrong" in source[n - 1])
    with pytest.raises(CompileError) as caught:
        trace(function, [(2,)])
    assert f"{__file__}:{line}: `" in str(caught.value)


def test_two_traces_do_not_meet():
    """A value kept from another trace is refused."""
    kept = nodes(1)
    with pytest.raises(CompileError, match="two different traces"):
        trace(lambda x: (x + kept[0],), [(2,)])
    with pytest.raises(CompileError, match="another trace"):
        trace(lambda x: (kept,), [(2,)])


FLOATS = st.floats(allow_nan=False, allow_infinity=False)


@settings(max_examples=100, deadline=None)
@given(FLOATS, FLOATS)
def test_arithmetic(a, b):
    """IEEE's, with Python's and NumPy's numbers on either side; comparisons are plain truth values."""
    with np.errstate(all="ignore"):
        expected = {"+": a + b, "-": a - b, "*": a * b, "/": np.float64(a) / np.float64(b), "<": a < b, ">=": a >= b}
    for x, y in ((Constant(a), Constant(b)), (Constant(a), b), (a, Constant(b)), (np.float64(a), Constant(b))):
        found = {"+": x + y, "-": x - y, "*": x * y, "/": x / y, "<": x < y, ">=": x >= y}
        for kind, result in found.items():
            assert isinstance(result, bool if kind in ("<", ">=") else Constant), kind
            np.testing.assert_equal(float(result), float(expected[kind]))
    assert float(-Constant(a)) == -a and float(abs(Constant(a))) == abs(a) and (Constant(a) == a)


def test_arrays_go_entry_by_entry():
    """In order: first product, then the sums; with floats and traced numbers in the same product."""
    random = np.random.default_rng(0)
    A, B = random.normal(size=(2, 3, 3))
    found = constants(A) @ constants(B)
    assert found.dtype == object and all(type(x) is Constant for x in found.flat)
    for mixed in (found, constants(A) @ B, A @ constants(B)):
        np.testing.assert_array_equal(mixed.astype(float), product(A, B))
    assert float(constants(A[0]) @ constants(B[0])) == dot(A[0], B[0])
    assert scalar.sqrt(Constant(2.0)).value == 2.0**0.5 and scalar.reciprocal(Constant(4.0)).value == 0.25
    assert scalar.where(Constant(1.0) < 2.0, 3.0, 4.0) == 3.0


def test_in_a_program():
    """Where a constant meets a traced number it is a constant of the program."""
    c = constants(np.array([0.5, 3.0]))
    assert trace(lambda x: (x @ c, c * x), [(2,)]) == trace(
        lambda x: (x @ c.astype(float), c.astype(float) * x), [(2,)]
    )
    assert trace(lambda: (c @ c,), []) == trace(lambda: (9.25,), [])


def test_no_condition():
    """A number is none."""
    with pytest.raises(CompileError, match="expected a comparison"):
        scalar.where(Constant(1.0), 2.0, 3.0)


def test_results():
    """Arrays, numbers, constants and truths come out, in shape."""
    program = trace(lambda A, x: (A @ x, x[0] < x[1], 3, np.eye(2), A.T), [(2, 2), (2,)])
    A, x = np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([5.0, 6.0])
    product, truth, three, unit, transposed = interpret(program, A, x)
    assert np.array_equal(product, A @ x)
    assert truth.shape == () and truth == 1.0 and three == 3.0
    assert np.array_equal(unit, np.eye(2)) and np.array_equal(transposed, A.T)
    assert [output.shape for output in program.outputs] == [(2,), (), (), (2, 2), (2, 2)]


def test_dead_and_shared():
    """What no result needs is dropped, unused inputs apart; what is computed twice is computed once."""

    def function(x, y):
        x[0] / x[1]
        return (x[0] * x[1] + x[0] * x[1], x[1] * x[0])

    program = trace(function, [(2,), (3,)])
    assert program.counts == {"multiply": 1, "add": 1}
    assert program.input_size == 5 and program.operation_count == 2


def test_order():
    """Operands come before their uses, and the same function gives the same program."""

    def function(x):
        return (np.cumsum(x * x[::-1]), np.sqrt(x))

    program = trace(function, [(6,)])
    assert all(a < place for place, i in enumerate(program.instructions) for a in i.args)
    assert program == trace(function, [(6,)])


def test_refusals():
    """Results must be a tuple of numbers, inputs must fit."""
    with pytest.raises(CompileError, match="tuple of arrays"):
        trace(lambda x: x, [(2,)])
    with pytest.raises(CompileError, match="expected numbers in result 0"):
        trace(lambda x: ("text",), [(2,)])
    with pytest.raises(CompileError, match="expected arrays of shapes"):
        interpret(trace(lambda x: (x,), [(2,)]), np.ones(3))


SPECIAL = [0.0, -0.0, 1.0, -1.0, math.inf, -math.inf, math.nan, 5e-324, -1e308]


@given(FLOATS, FLOATS, FLOATS)
def test_fma_is_rounded_once(a, b, c):
    """a b + c is the double nearest to the exact value."""
    exact = Fraction(a) * Fraction(b) + Fraction(c)
    try:
        assert arithmetic.fma(a, b, c) == float(exact)
    except OverflowError:
        assert arithmetic.fma(a, b, c) == (math.inf if exact > 0 else -math.inf)


def test_fma_keeps_what_a_product_loses():
    """The part that rounding the product drops."""
    a = 1.0 + 2.0**-30
    assert arithmetic.fma(a, a, -(a * a)) == 2.0**-60


def test_fma_of_special_values():
    """Infinities, zeros with their signs, NaN: as in extended precision, which holds these products exactly."""
    for a, b, c in itertools.product(SPECIAL, repeat=3):
        with np.errstate(all="ignore"):
            expected = float(np.longdouble(a) * np.longdouble(b) + np.longdouble(c))
        assert same(arithmetic.fma(a, b, c), expected), (a, b, c)


def test_division():
    """Division by zero is an infinity or NaN, never an exception."""
    for a, b in itertools.product(SPECIAL, repeat=2):
        with np.errstate(all="ignore"):
            expected = float(np.float64(a) / np.float64(b))
        assert same(arithmetic.divide(a, b), expected), (a, b)


def same(a: float, b: float) -> bool:
    """Return whether two numbers are the same, with the sign of a zero; NaN is NaN."""
    return (math.isnan(a) and math.isnan(b)) or (a, math.copysign(1.0, a)) == (b, math.copysign(1.0, b))


def test_roots():
    """The root of a negative number is NaN, of -0.0 it is -0.0."""
    assert math.isnan(arithmetic.sqrt(-1.0)) and math.isnan(arithmetic.sqrt(math.nan))
    assert math.copysign(1.0, arithmetic.sqrt(-0.0)) == -1.0
