"""Kernels tied to arrays: their own, or the caller's."""

import gc
import weakref

import numpy as np
import pytest

from holdfast.compiler.kernel import aligned, compile_program
from holdfast.compiler.trace import trace


@pytest.fixture(scope="module")
def kernel():
    """Sum and product of x (2,) and y (3,)."""
    return compile_program(trace(lambda x, y: (x.sum() + y.sum(), x[0] * y), [(2,), (3,)]))


def test_arrays_are_one_block(kernel):
    """In the order of the schedule, at a cache line, with nothing between."""
    bound = kernel.bind()
    assert list(bound.arrays) == ["in0", "in1", "out0", "out1"]
    assert [a.shape for a in bound.arrays.values()] == [(2,), (3,), (), (3,)]
    assert bound.memory.size == 9 and bound.memory.ctypes.data % 64 == 0
    assert [(a.ctypes.data - bound.memory.ctypes.data) // 8 for a in bound.arrays.values()] == [0, 2, 5, 6]
    assert bound.table[:-1].tolist() == [a.ctypes.data for a in bound.arrays.values()]


def test_the_callers_arrays(kernel):
    """`use` ties some arrays to other memory, in and out, and leaves the rest."""
    bound = kernel.bind()
    bound.arrays["in0"][:] = 1.0, 2.0
    mine = {"in1": np.array([3.0, 4.0, 5.0]), "out1": np.zeros(3)}
    bound.use(mine)
    assert bound.run() == 0
    assert bound.arrays["out0"] == 15.0 and mine["out1"].tolist() == [3.0, 4.0, 5.0]
    mine["in1"][:] = 7.0
    bound.run()
    assert mine["out1"].tolist() == [7.0] * 3
    assert bound.arrays["out1"] is mine["out1"]


def test_the_call_outlives_the_kernel():
    """The call alone keeps code and arrays alive, and lets go of them at its end."""
    kernel = compile_program(trace(lambda x: (x * 2.0,), [(2,)]))
    bound = kernel.bind()
    run, x, y = bound.run, bound.arrays["in0"], bound.arrays["out0"]
    gone = weakref.ref(bound)
    del bound, kernel
    gc.collect()
    x[:] = 1.0, 4.0
    run()
    assert y.tolist() == [2.0, 8.0]
    del run, x, y
    gc.collect()
    assert gone() is None


def test_aligned():
    """Zeros that begin at a cache line, as many as asked for."""
    for count in range(20):
        memory = aligned(count)
        assert memory.shape == (count,) and not memory.any()
        assert memory.ctypes.data % 64 == 0 or not count
