"""Exponential and hyperbolic tangent against 60 digits."""

import math

import mpmath
import numpy as np
import pytest

from holdfast.compiler.interpret import interpret
from holdfast.compiler.trace import trace
from holdfast.spatial.scalar import exp, tanh
from tests.compiler.programs import compile_program, same_bits
from tests.compiler.test_trigonometry import ulps

PROGRAM = trace(lambda x: (exp(x), tanh(x)), [(1,)])


@pytest.fixture(scope="module")
def kernel():
    """Both in machine code."""
    return compile_program(PROGRAM)


@pytest.mark.parametrize(
    "x",
    [
        np.random.default_rng(2).uniform(-2, 2, 4000),
        np.random.default_rng(3).uniform(-708, 709.7, 4000),
        np.exp(np.random.default_rng(4).uniform(math.log(1e-300), math.log(700), 4000)),
        -np.exp(np.random.default_rng(5).uniform(math.log(1e-300), math.log(700), 4000)),
        np.array([0.0, 5e-324, 709.782712893384, -708.3964185322641, 20.0, np.nextafter(20.0, 21.0), 0.34657359]),
    ],
    ids=["ordinary", "all", "sizes", "negative", "ends"],
)
def test_accuracy(kernel, x):
    """Below one and three units in the last place."""
    exponential, tangent = (a[:, 0] for a in kernel(x[:, None]))
    with mpmath.workdps(60):
        errors = [
            ulps(f, [g(mpmath.mpf(v)) for v in x.tolist()])
            for f, g in ((exponential, mpmath.exp), (tangent, mpmath.tanh))
        ]
    print(f"largest errors of exp and tanh: {errors[0]:.3f} and {errors[1]:.3f} ulp")
    assert errors[0] <= 1.0
    assert errors[1] <= 3.0


@pytest.mark.parametrize(
    ("x", "exponential", "tangent"),
    [
        (0.0, 1.0, 0.0),
        (-0.0, 1.0, -0.0),
        (710.0, math.inf, 1.0),
        (1e300, math.inf, 1.0),
        (math.inf, math.inf, 1.0),
        (-709.0, 0.0, -1.0),
        (-math.inf, 0.0, -1.0),
        (math.nan, math.nan, math.nan),
    ],
)
def test_ends(kernel, x, exponential, tangent):
    """Overflow, what would lose digits, zeros of both signs, not-a-number; the interpreter agrees to the bit."""
    found = [float(a[0, 0]) for a in kernel(np.array([[x]]))]
    assert same_bits(found, [exponential, tangent])
    assert same_bits(found, [a[0] for a in interpret(PROGRAM, np.array([x]))])


def test_signs_and_order(kernel):
    """tanh is odd to the bit and never beyond 1; a larger x has no smaller exponential."""
    x = np.sort(np.random.default_rng(6).uniform(-25, 25, 2000))[:, None]
    (e, t), (_, minus) = kernel(x), kernel(-x)
    assert same_bits(t, -minus)
    assert (np.diff(e[:, 0]) >= 0).all()
    assert np.abs(t).max() <= 1.0
