"""The vocabulary of traced functions means the same on floats and on scalars of other kinds."""

import inspect
import math
import re
from pathlib import Path

import numpy as np
import pytest

from holdfast.compiler.interpret import interpret
from holdfast.compiler.trace import trace
from holdfast.spatial import scalar
from tests.spatial.dual import Dual, duals, slopes_of


@pytest.mark.parametrize("x", [0.0, 1e-300, 0.3, 2.0, 1e5])
@pytest.mark.parametrize(
    ("name", "derivative"),
    [("sin", math.cos), ("cos", lambda x: -math.sin(x)), ("sqrt", lambda x: 0.5 / math.sqrt(x))],
)
def test_functions(name, derivative, x):
    """A float gives the C library's value; another scalar its own."""
    assert getattr(scalar, name)(x) == getattr(math, name)(x)
    if name != "sqrt" or x > 0:
        other = getattr(scalar, name)(Dual(x, 2.0))
        assert (other.value, other.tangent) == (getattr(math, name)(x), 2.0 * derivative(x))


def test_root_of_a_negative():
    """A negative radicand is not a number: visible later, no exception inside an algorithm."""
    assert math.isnan(scalar.sqrt(-1e-300))
    assert math.isnan(scalar.sqrt(math.nan))


@pytest.mark.parametrize(("a", "b"), [(1.0, 2.0), (2.0, 1.0), (-0.5, -0.5)])
def test_selection(a, b):
    """Comparisons select without a branch, on any scalar."""
    assert scalar.maximum(a, b) == max(a, b)
    assert scalar.minimum(a, b) == min(a, b)
    assert scalar.maximum(Dual(a), Dual(b)).value == max(a, b)
    assert scalar.minimum(Dual(a), Dual(b)).value == min(a, b)
    assert scalar.where(a < b, "yes", "no") == scalar.where(Dual(a) < Dual(b), "yes", "no")


def test_arrays():
    """Numbers make float arrays, other scalars object arrays, nothing an empty array."""
    assert scalar.array([1.0, 2]).dtype == float
    mixed = scalar.array([1.0, Dual(2.0, 3.0)])
    assert mixed.dtype == object
    np.testing.assert_array_equal(slopes_of(mixed), [0.0, 3.0])
    assert scalar.concatenate([]).shape == (0,)
    np.testing.assert_array_equal(scalar.concatenate(x for x in ([1.0], [2.0, 3.0])), [1.0, 2.0, 3.0])
    assert scalar.concatenate([np.zeros(2), duals([1.0], 1.0)]).dtype == object


NUMBERS = np.array([[-1.5, 0.0, 0.3], [2.0, -0.25, 1e5]])
VOCABULARY = {
    "sin": (scalar.sin, 1),
    "cos": (scalar.cos, 1),
    "sqrt": (scalar.sqrt, 1),
    "exp": (scalar.exp, 1),
    "tanh": (scalar.tanh, 1),
    "arctan2": (scalar.arctan2, 2),
    "clip": (lambda x, y: scalar.clip(x, -0.4, y), 2),
    "reciprocal": (scalar.reciprocal, 1),
    "minimum": (scalar.minimum, 2),
    "maximum": (scalar.maximum, 2),
    "clipped": (lambda x, y: scalar.where(scalar.less(x, y), x, np.multiply(2.0, y)), 2),
    "chosen": (lambda x, y: scalar.where(scalar.less_equal(y, x), x, 0.0), 2),
}
OTHERS = (0.3, np.float64(-0.25), np.array(0.3), np.array([0.0, 0.3, -2.0]), [0.0, 0.3, -2.0], np.array([[0.3], [0.0]]))


@pytest.mark.parametrize("name", VOCABULARY)
@pytest.mark.parametrize("other", OTHERS, ids=str)
def test_entry_by_entry(name, other):
    """On arrays and lists, broadcast as NumPy does it: what a loop over the entries finds, to the bit."""
    function, count = VOCABULARY[name]
    arguments = (NUMBERS, other)[:count]
    found = function(*arguments)
    expected = np.empty(NUMBERS.shape)
    for place, entries in enumerate(zip(*(a.flat for a in np.broadcast_arrays(*arguments)), strict=True)):
        expected.flat[place] = function(*(float(x) for x in entries))
    assert found.dtype == float and found.shape == NUMBERS.shape
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("name", VOCABULARY)
@pytest.mark.parametrize("other", OTHERS, ids=str)
def test_entry_by_entry_when_traced(name, other):
    """A traced function of arrays computes what it does on floats."""
    function, count = VOCABULARY[name]
    if count == 1:
        program = trace(lambda x: (function(x),), [NUMBERS.shape])
        (found,) = interpret(program, NUMBERS)
        expected = function(NUMBERS)
    else:
        program = trace(lambda x: (function(x, other), function(other, x)), [NUMBERS.shape])
        found = np.array(interpret(program, NUMBERS))
        expected = np.array([function(NUMBERS, other), function(other, NUMBERS)])
    np.testing.assert_allclose(found, expected, rtol=1e-14, atol=1e-15)


def test_lists_are_not_compared_as_lists():
    """Python compares lists by their first difference."""
    np.testing.assert_array_equal(scalar.maximum([1.0, 2.0], [0.0, 5.0]), [1.0, 5.0])
    assert scalar.minimum(np.array(2.0), 3.0) == 2.0


def test_the_documented_words():
    """The table of what laws may say has every function of the vocabulary."""
    page = (Path(__file__).parents[2] / "docs" / "how_to" / "rollouts.md").read_text()
    table = page[page.index("| function | arguments") : page.index("If a law does anything else")]
    rows = [row for row in table.splitlines()[2:] if row.startswith("|")]
    told = {name for row in rows for name in re.findall(r"`(\w+)`", row.split("|")[1])}
    words = {name for name, f in vars(scalar).items() if inspect.isfunction(f) and name[0] != "_"}
    assert told - {"abs"} == words
