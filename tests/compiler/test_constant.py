"""Constants of a trace: numbers that NumPy's arrays hold one by one, so that no BLAS multiplies them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from holdfast.compiler.constant import Constant, constants
from holdfast.compiler.errors import CompileError
from holdfast.compiler.trace import trace
from holdfast.spatial import scalar
from holdfast.spatial.vector import dot, product

NUMBERS = st.floats(allow_nan=False, allow_infinity=False)


@settings(max_examples=100, deadline=None)
@given(NUMBERS, NUMBERS)
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
