"""Machine code: the interpreter's bits, alone, in lanes, in tails, in threads."""

import gc
import weakref
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from holdfast.compiler.interpret import interpret
from holdfast.compiler.targets import cpu
from holdfast.compiler.trace import trace
from tests.compiler.programs import NUMBERS, all_same_bits, compile_program, programs

SIZES = st.sampled_from([1, 2, 3, 7, 8, 9, 17])


@settings(max_examples=30, deadline=None)
@given(programs(), SIZES, st.data())
def test_same_bits(program, batch, data):
    """Interpreter = single = lanes = tails = threads on random programs and inputs."""
    values = data.draw(st.lists(NUMBERS, min_size=7, max_size=7))
    random = np.random.default_rng(batch)
    with np.errstate(over="ignore"):
        x = np.array(values) * np.concatenate([[np.ones(7)], random.uniform(-2, 2, (batch - 1, 7))])
    a, b = x[:, :3].copy(), x[:, 3:].reshape(batch, 2, 2).copy()
    kernel = compile_program(program)
    singles = [kernel(a[i], b[i]) for i in range(batch)]
    for i in (0, batch - 1):
        assert all_same_bits(singles[i], interpret(program, a[i], b[i]))
    stacked = tuple(np.stack([s[k] for s in singles]) for k in range(2))
    for threads in (1, 3):
        assert all_same_bits(kernel(a, b, threads=threads), stacked)
    assert all_same_bits(compile_program(program, lanes=2)(a, b), stacked)


@pytest.mark.slow
@settings(max_examples=20, deadline=None)
@given(programs())
def test_long_texts(program):
    """What is compiled with less care, for its length, computes the same bits."""
    x = (np.array([0.3, -1.7, 2.9]), np.array([[0.1, 5.3], [-0.7, 1.1]]))
    careful = compile_program(program)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cpu, "_LONG", 0)
        quick = compile_program(program)
        assert all_same_bits(quick(*x), careful(*x))
        batch = tuple(np.stack([a, 2.0 * a, -a]) for a in x)
        assert all_same_bits(quick(*batch), careful(*batch))


@settings(max_examples=20, deadline=None)
@given(programs())
def test_unfused(program):
    """LLVM does not fuse on its own."""
    x = (np.array([0.3, -1.7, 2.9]), np.array([[0.1, 5.3], [-0.7, 1.1]]))
    assert all_same_bits(compile_program(program, fused=False)(*x), interpret(program, *x, fused=False))


@pytest.fixture(scope="module")
def kernel():
    """A kernel of A (2, 2), x (2,), s () with a matrix, a vector and a number as results."""
    return compile_program(trace(lambda A, x, s: (A @ A * s[()], A @ x, x @ x), [(2, 2), (2,), ()]))


def numbers(batch):
    """Return random inputs of the kernel."""
    random = np.random.default_rng(0)
    return random.normal(size=(batch, 2, 2)), random.normal(size=(batch, 2)), random.normal(size=batch)


def test_values(kernel):
    """Against NumPy."""
    A, x, s = numbers(13)
    AA, Ax, xx = kernel(A, x, s)
    np.testing.assert_allclose(AA, A @ A * s[:, None, None], rtol=1e-14)
    np.testing.assert_allclose(Ax, np.einsum("bij,bj->bi", A, x), rtol=1e-13)
    np.testing.assert_allclose(xx, (x * x).sum(1), rtol=1e-14)
    assert [r.shape for r in kernel(A[0], x[0], s[0])] == [(2, 2), (2,), ()]


def test_shared_inputs(kernel):
    """An input without the batch axis is the same for all systems."""
    A, x, _ = numbers(5)
    found = kernel(A[2], x, 0.5)
    assert all_same_bits(found, kernel(np.repeat(A[2:3], 5, 0), x, np.full(5, 0.5)))


def test_bound(kernel):
    """Arrays of its own, written and read in place; two of them are apart."""
    A, x, s = numbers(2)
    one, other = kernel.bind(), kernel.bind()
    for bound, i in ((one, 0), (other, 1)):
        for name, value in zip(("in0", "in1", "in2"), (A[i], x[i], s[i]), strict=True):
            bound.arrays[name][...] = value
        assert bound.run() == 0
    for bound, i in ((one, 0), (other, 1)):
        outputs = tuple(bound.arrays[name] for name in ("out0", "out1", "out2"))
        assert all_same_bits(outputs, kernel(A[i], x[i], s[i]))


def test_the_callers_arrays():
    """`use` ties some arrays to other memory, in and out, and leaves the rest."""
    bound = compile_program(trace(lambda x, y: (x.sum() + y.sum(), x[0] * y), [(2,), (3,)])).bind()
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


def test_threads_of_the_caller(kernel):
    """Single calls and batches from many threads do not disturb each other."""
    A, x, s = numbers(64)
    expected = kernel(A, x, s)

    def call(i: int) -> bool:
        single = all_same_bits(kernel(A[i], x[i], s[i]), tuple(r[i] for r in expected))
        return single and all_same_bits(kernel(A, x, s), expected)

    with ThreadPoolExecutor(8) as pool:
        assert all(pool.map(call, [*range(64)] * 20))


def test_nothing_in_or_out():
    """Programs without inputs, with empty ones, or without results."""
    constant = compile_program(trace(lambda: (np.arange(3.0), 2.0), []))
    assert np.array_equal(constant()[0], np.arange(3.0)) and constant()[1] == 2.0
    empty = compile_program(trace(lambda x, y: (x, y * 2.0), [(0,), (2,)]))
    first, second = empty(np.zeros((3, 0)), np.ones((3, 2)))
    assert first.shape == (3, 0) and np.array_equal(second, np.full((3, 2), 2.0))
    first, second = empty(np.zeros(0), np.ones(2))
    assert first.shape == (0,) and np.array_equal(second, np.full(2, 2.0))
    assert compile_program(trace(lambda x: (), [(2,)]))(np.ones((9, 2))) == ()


@pytest.mark.slow
def test_long_programs():
    """More instructions than one block takes."""

    def function(x):
        for k in range(2500):
            x = np.array([x[1] + 0.5 * x[0] * x[0], x[0] / (1.25 + x[1] * x[1])]) if k % 2 else x - x * x * 0.25
        return (x, x[0])

    program = trace(function, [(2,)])
    assert len(program.instructions) > 10000
    kernel = compile_program(program)
    x = np.random.default_rng(1).uniform(0, 1, (9, 2))
    singles = [kernel(row) for row in x]
    assert all_same_bits(singles[3], interpret(program, x[3]))
    assert all_same_bits(kernel(x), tuple(np.stack(r) for r in zip(*singles, strict=True)))
