"""Programs from functions."""

import numpy as np
import pytest

from holdfast.compiler.errors import CompileError
from holdfast.compiler.interpret import interpret
from holdfast.compiler.trace import trace


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
