"""Identities of the graph: structural ones by name, and all of them by value on random programs."""

import numpy as np
import pytest

from holdfast.compiler.graph import Graph

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
