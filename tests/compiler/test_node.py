"""Nodes in NumPy arrays, and what a function must not do with them."""

import math
from pathlib import Path

import numpy as np
import pytest

from holdfast.compiler.errors import CompileError
from holdfast.compiler.graph import Graph
from holdfast.compiler.node import Node
from holdfast.compiler.trace import trace
from holdfast.spatial.scalar import maximum, select, where


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
