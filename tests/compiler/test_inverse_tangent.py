"""The inverse tangent against 40 digits."""

import math

import mpmath
import numpy as np
import pytest

from holdfast.compiler.interpret import interpret
from holdfast.compiler.lowering import expand
from holdfast.compiler.trace import trace
from holdfast.spatial.scalar import arctan2
from tests.compiler.programs import compile_program, same_bits

PROGRAM = trace(lambda y, x: (arctan2(y, x),), [(1,), (1,)])
TINY, HUGE = 5e-324, 1.7976931348623157e308


@pytest.fixture(scope="module")
def kernel():
    """It in machine code."""
    return compile_program(PROGRAM)


def angles(kernel, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return what machine code finds of many points."""
    return kernel(np.ascontiguousarray(y[:, None]), np.ascontiguousarray(x[:, None]))[0][:, 0]


def points(kind: str, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return y and x of random points."""
    random = np.random.default_rng(sum(map(ord, kind)))
    if kind == "circle":
        angle = random.uniform(-np.pi, np.pi, count)
        return np.sin(angle), np.cos(angle)
    if kind == "sizes":
        return tuple(random.choice([-1, 1], count) * 2.0 ** random.uniform(-1070, 1023, count) for _ in range(2))
    if kind == "small angles":
        return random.normal(size=count) * 2.0 ** random.uniform(-1000, 0, count), random.uniform(0.5, 2.0, count)
    if kind == "near pi":
        return random.normal(size=count) * 2.0 ** random.uniform(-60, 0, count), -random.uniform(0.5, 2.0, count)
    quotient = (
        random.choice([0.25, 0.75, 1.0, 0.5], count) + random.integers(-3, 4, count) * 2.0**-52
    )  # where c changes
    x = random.choice([-1, 1], count) * random.uniform(0.5, 2.0, count)
    return random.choice([-1, 1], count) * quotient * x, x


KINDS = ("circle", "sizes", "small angles", "near pi", "changes")


def worst(kernel, kind: str, count: int) -> float:
    """Return the largest error in units in the last place; smaller ones than the least normal number count as that."""
    y, x = points(kind, count)
    found = angles(kernel, y, x)
    with mpmath.workprec(130):
        exact = [mpmath.atan2(mpmath.mpf(a), mpmath.mpf(b)) for a, b in zip(y.tolist(), x.tolist(), strict=True)]
        errors = [float(abs(mpmath.mpf(f) - e)) for f, e in zip(found.tolist(), exact, strict=True)]
        units = [math.ulp(float(e)) for e in exact]
    return max(error / unit for error, unit in zip(errors, units, strict=True))


@pytest.mark.parametrize("kind", KINDS)
def test_accuracy(kernel, kind):
    """At most one unit in the last place."""
    assert worst(kernel, kind, 2000) <= 1.0


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_accuracy_of_many(kernel, kind):
    error = worst(kernel, kind, 200_000)
    print(f"largest error of arctan2 ({kind}): {error:.3f} ulp")
    assert error <= 1.0


@pytest.mark.parametrize(
    ("y", "x", "angle"),
    [
        (0.0, 1.0, 0.0),
        (-0.0, 1.0, 0.0),
        (0.0, 0.0, 0.0),
        (-0.0, -0.0, 0.0),
        (0.0, -1.0, math.pi),
        (-0.0, -1.0, math.pi),
        (1.0, 0.0, math.pi / 2),
        (-1.0, -0.0, -math.pi / 2),
        (1.0, 1.0, math.pi / 4),
        (-1.0, 1.0, -math.pi / 4),
        (1.0, -1.0, 3 * math.pi / 4),
        (-1.0, -1.0, -3 * math.pi / 4),
        (TINY, 1.0, TINY),
        (-TINY, 1.0, -TINY),
        (TINY, -1.0, math.pi),
        (-TINY, -1.0, -math.pi),
        (TINY, TINY, math.pi / 4),
        (TINY, HUGE, 0.0),
        (HUGE, TINY, math.pi / 2),
        (HUGE, HUGE, math.pi / 4),
        (HUGE, -HUGE, 3 * math.pi / 4),
        (1e-310, 2e-310, math.atan2(1e-310, 2e-310)),
        (math.inf, 1.0, math.nan),
        (1.0, math.inf, math.nan),
        (1.0, -math.inf, math.nan),
        (math.inf, math.inf, math.nan),
        (math.nan, 1.0, math.nan),
        (1.0, math.nan, math.nan),
    ],
)
def test_special_points(kernel, y, x, angle):
    """Axes and diagonals, zeros without a sign, subnormal and huge numbers; infinite ones have no angle."""
    found = float(angles(kernel, np.array([y]), np.array([x]))[0])
    assert found == angle or (math.isnan(found) and math.isnan(angle))
    assert same_bits([found], [interpret(PROGRAM, np.array([y]), np.array([x]))[0][0]])
    if math.isfinite(y) and math.isfinite(x):
        assert arctan2(y, x) == angle


@pytest.mark.parametrize(
    "function",
    [lambda x: arctan2(x, 0.5), lambda x: arctan2(x, -0.5), lambda x: arctan2(-0.3, x)],
    ids=["x", "-x", "y"],
)
def test_one_of_them_a_constant(function):
    """What depends on the constant alone is computed while the program is lowered."""
    program = trace(lambda x: (function(x),), [(1,)])
    x = np.array([0.7])
    assert interpret(program, x)[0][0] == compile_program(program)(x[:, None])[0][0, 0] == pytest.approx(function(0.7))
    instructions = expand(program).instructions
    for _, places, _ in instructions:
        assert not places or any(instructions[p][0] != "constant" for p in places)


@pytest.mark.parametrize("kind", KINDS)
def test_bits(kernel, kind):
    """Odd in y to the bit; the interpreter agrees, and so does a batch of one."""
    y, x = points(kind, 300)
    found = angles(kernel, y, x)
    assert np.array_equal(angles(kernel, -y, x), -found)
    for k in range(0, 300, 7):
        assert interpret(PROGRAM, y[k : k + 1], x[k : k + 1])[0][0] == found[k]
        assert angles(kernel, y[k : k + 1], x[k : k + 1])[0] == found[k]
