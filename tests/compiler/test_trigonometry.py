"""Sine and cosine against 60 digits."""

import math

import mpmath
import numpy as np
import pytest

from holdfast.compiler.elementary import LARGEST_ARGUMENT
from holdfast.compiler.lowering import expand
from holdfast.compiler.trace import trace
from tests.compiler.programs import compile_program

PROGRAM = trace(lambda x: (np.sin(x), np.cos(x)), [(1,)])


@pytest.fixture(scope="module")
def kernel():
    """Sine and cosine in machine code."""
    return compile_program(PROGRAM)


def hard_arguments() -> np.ndarray:
    """Return doubles near multiples of pi/4, those nearest to multiples of pi/2 among them."""
    random = np.random.default_rng(1)
    with mpmath.workdps(40):
        near = [float(n * mpmath.pi / 4) for n in [*range(1, 200), *random.integers(1, 127323, 4000)]]
    near = np.array([x for y in near for x in (np.nextafter(y, 0), y, np.nextafter(y, np.inf))])
    return near[near <= LARGEST_ARGUMENT]


def ulps(found: np.ndarray, exact: list[mpmath.mpf]) -> float:
    """Return the largest error in units in the last place of the exact value."""
    return max(float(abs(mpmath.mpf(f) - e)) / math.ulp(float(e)) for f, e in zip(found.tolist(), exact, strict=True))


@pytest.mark.parametrize(
    "x",
    [
        np.random.default_rng(2).uniform(-np.pi, np.pi, 8000),
        np.random.default_rng(3).uniform(-LARGEST_ARGUMENT, LARGEST_ARGUMENT, 8000),
        np.exp(np.random.default_rng(4).uniform(math.log(1e-20), math.log(1e5), 4000)),
        hard_arguments(),
        np.array([0.0, 5e-324, 1e-308, LARGEST_ARGUMENT, -LARGEST_ARGUMENT]),
    ],
    ids=["turn", "all", "sizes", "hard", "ends"],
)
def test_accuracy(kernel, x):
    """At most one unit in the last place, wherever |x| <= 1e5."""
    sine, cosine = (a[:, 0] for a in kernel(x[:, None]))
    with mpmath.workdps(60):
        errors = [
            ulps(f, [g(mpmath.mpf(v)) for v in x.tolist()]) for f, g in ((sine, mpmath.sin), (cosine, mpmath.cos))
        ]
    print(f"largest errors of sin and cos: {errors[0]:.3f} and {errors[1]:.3f} ulp")
    assert max(errors) <= 1.0


def test_symmetry(kernel):
    """sin is odd, cos is even, to the bit."""
    x = np.concatenate([np.random.default_rng(5).uniform(0, 100, 500), hard_arguments()[:500]])[:, None]
    (s, c), (s_minus, c_minus) = kernel(x), kernel(-x)
    assert np.array_equal(s, -s_minus) and np.array_equal(c, c_minus)


@pytest.mark.parametrize("x", [np.nextafter(1e5, np.inf), -1e6, 1e300, np.inf, -np.inf, np.nan])
def test_beyond(kernel, x):
    """No wrong value beyond 1e5 rad: NaN; at 1e5 rad still a value."""
    assert all(np.isnan(a).all() for a in kernel(np.array([x])))
    assert all(np.isfinite(a).all() for a in kernel(np.array([1e5])))


def test_shared_reduction():
    """sin and cos of one argument cost less than twice the sine."""
    one, both = (
        expand(trace(function, [()]))
        for function in (lambda x: (np.sin(x[()]),), lambda x: (np.sin(x[()]), np.cos(x[()])))
    )
    assert both.operation_count < one.operation_count + 5
