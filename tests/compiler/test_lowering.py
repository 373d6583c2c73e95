"""Products in sums."""

import math

import numpy as np
from hypothesis import given, settings

from holdfast.compiler.interpret import interpret
from holdfast.compiler.lowering import expand, fuse, lowered
from holdfast.compiler.trace import trace
from tests.compiler.programs import all_same_bits, programs

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
