"""Elementary functions as machine code against 60 digits, and the interpreter's bits."""

import functools
import math
from collections.abc import Callable

import mpmath
import numpy as np
import pytest

from holdfast.compiler.elementary import LARGEST_ARGUMENT
from holdfast.compiler.interpret import interpret
from holdfast.compiler.lowering import expand
from holdfast.compiler.trace import trace
from holdfast.spatial.scalar import arctan2, exp, tanh
from tests.compiler.programs import ArrayKernel, compile_program, same_bits


class Pair:
    """Two functions of one argument.

    Attributes:
        program: both, of an array of one number.
        exact: both by mpmath, each with its largest error [units in the last place].
    """

    def __init__(self, function: Callable, **exact: float) -> None:
        self.program, self.exact = trace(function, [(1,)]), exact

    @functools.cached_property
    def kernel(self) -> ArrayKernel:
        """Both in machine code."""
        return compile_program(self.program)


CIRCLE = Pair(lambda x: (np.sin(x), np.cos(x)), sin=1.0, cos=1.0)
GROWTH = Pair(lambda x: (exp(x), tanh(x)), exp=1.0, tanh=3.0)
ANGLE = trace(lambda y, x: (arctan2(y, x),), [(1,), (1,)])
TINY, HUGE = 5e-324, 1.7976931348623157e308


@functools.cache
def kernel_of_angles() -> ArrayKernel:
    """Return the inverse tangent as machine code."""
    return compile_program(ANGLE)


def angles(y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return what machine code finds of many points."""
    return kernel_of_angles()(np.ascontiguousarray(y[:, None]), np.ascontiguousarray(x[:, None]))[0][:, 0]


def hard_arguments() -> np.ndarray:
    """Return doubles near multiples of pi/4, those nearest to multiples of pi/2 among them."""
    random = np.random.default_rng(1)
    with mpmath.workdps(40):
        near = [float(n * mpmath.pi / 4) for n in [*range(1, 200), *random.integers(1, 127323, 4000)]]
    near = np.array([x for y in near for x in (np.nextafter(y, 0), y, np.nextafter(y, np.inf))])
    return near[near <= LARGEST_ARGUMENT]


def drawn(seed: int, low: float, high: float, count: int) -> np.ndarray:
    """Return random numbers."""
    return np.random.default_rng(seed).uniform(low, high, count)


SIZES = math.log(1e-300), math.log(700)
ARGUMENTS = {
    "turn": (CIRCLE, drawn(2, -np.pi, np.pi, 8000)),
    "all angles": (CIRCLE, drawn(3, -LARGEST_ARGUMENT, LARGEST_ARGUMENT, 8000)),
    "sizes of angles": (CIRCLE, np.exp(drawn(4, math.log(1e-20), math.log(1e5), 4000))),
    "hard": (CIRCLE, hard_arguments()),
    "ends of angles": (CIRCLE, np.array([0.0, 5e-324, 1e-308, LARGEST_ARGUMENT, -LARGEST_ARGUMENT])),
    "ordinary": (GROWTH, drawn(2, -2, 2, 4000)),
    "all exponents": (GROWTH, drawn(3, -708, 709.7, 4000)),
    "sizes": (GROWTH, np.exp(drawn(4, *SIZES, 4000))),
    "negative": (GROWTH, -np.exp(drawn(5, *SIZES, 4000))),
    "ends": (
        GROWTH,
        np.array([0.0, 5e-324, 709.782712893384, -708.3964185322641, 20.0, np.nextafter(20.0, 21.0), 0.34657359]),
    ),
}


@pytest.mark.parametrize("name", ARGUMENTS)
def test_accuracy(name):
    """At most one unit in the last place, three of tanh; of sine and cosine wherever |x| <= 1e5."""
    pair, x = ARGUMENTS[name]
    for found, (function, most) in zip(pair.kernel(x[:, None]), pair.exact.items(), strict=True):
        with mpmath.workdps(60):
            exact = [getattr(mpmath, function)(mpmath.mpf(v)) for v in x.tolist()]
            errors = [
                abs(mpmath.mpf(f) - e) / math.ulp(float(e)) for f, e in zip(found[:, 0].tolist(), exact, strict=True)
            ]
        print(f"largest error of {function}: {float(max(errors)):.3f} ulp")
        assert max(errors) <= most


def test_symmetry():
    """sin is odd, cos is even, to the bit."""
    x = np.concatenate([np.random.default_rng(5).uniform(0, 100, 500), hard_arguments()[:500]])[:, None]
    (s, c), (s_minus, c_minus) = CIRCLE.kernel(x), CIRCLE.kernel(-x)
    assert np.array_equal(s, -s_minus) and np.array_equal(c, c_minus)


@pytest.mark.parametrize("x", [np.nextafter(1e5, np.inf), -1e6, 1e300, np.inf, -np.inf, np.nan])
def test_beyond(x):
    """No wrong value beyond 1e5 rad: NaN; at 1e5 rad still a value."""
    assert all(np.isnan(a).all() for a in CIRCLE.kernel(np.array([x])))
    assert all(np.isfinite(a).all() for a in CIRCLE.kernel(np.array([1e5])))


def test_shared_reduction():
    """sin and cos of one argument cost less than twice the sine."""
    one, both = (
        expand(trace(function, [()]))
        for function in (lambda x: (np.sin(x[()]),), lambda x: (np.sin(x[()]), np.cos(x[()])))
    )
    assert both.operation_count < one.operation_count + 5


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
def test_ends_of_the_exponential(x, exponential, tangent):
    """Overflow, what would lose digits, zeros of both signs, not-a-number; the interpreter agrees to the bit."""
    found = [float(a[0, 0]) for a in GROWTH.kernel(np.array([[x]]))]
    assert same_bits(found, [exponential, tangent])
    assert same_bits(found, [a[0] for a in interpret(GROWTH.program, np.array([x]))])


def test_signs_and_order():
    """tanh is odd to the bit and never beyond 1; a larger x has no smaller exponential."""
    x = np.sort(np.random.default_rng(6).uniform(-25, 25, 2000))[:, None]
    (e, t), (_, minus) = GROWTH.kernel(x), GROWTH.kernel(-x)
    assert same_bits(t, -minus)
    assert (np.diff(e[:, 0]) >= 0).all()
    assert np.abs(t).max() <= 1.0


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


def worst(kind: str, count: int) -> float:
    """Return the largest error in units in the last place; smaller ones than the least normal number count as that."""
    y, x = points(kind, count)
    found = angles(y, x)
    with mpmath.workprec(130):
        exact = [mpmath.atan2(mpmath.mpf(a), mpmath.mpf(b)) for a, b in zip(y.tolist(), x.tolist(), strict=True)]
        errors = [float(abs(mpmath.mpf(f) - e)) for f, e in zip(found.tolist(), exact, strict=True)]
        units = [math.ulp(float(e)) for e in exact]
    return max(error / unit for error, unit in zip(errors, units, strict=True))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("count", [2000, pytest.param(200_000, marks=pytest.mark.long)])
def test_accuracy_of_angles(kind, count):
    """At most one unit in the last place."""
    error = worst(kind, count)
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
def test_special_points(y, x, angle):
    """Axes and diagonals, zeros without a sign, subnormal and huge numbers; infinite ones have no angle."""
    found = float(angles(np.array([y]), np.array([x]))[0])
    assert found == angle or (math.isnan(found) and math.isnan(angle))
    assert same_bits([found], [interpret(ANGLE, np.array([y]), np.array([x]))[0][0]])
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
def test_bits_of_angles(kind):
    """Odd in y to the bit; the interpreter agrees, and so does a batch of one."""
    y, x = points(kind, 300)
    found = angles(y, x)
    assert np.array_equal(angles(-y, x), -found)
    for k in range(0, 300, 7):
        assert interpret(ANGLE, y[k : k + 1], x[k : k + 1])[0][0] == found[k]
        assert angles(y[k : k + 1], x[k : k + 1])[0] == found[k]
