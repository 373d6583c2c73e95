"""Derivatives of functions: operations against differences, gradients of gradients, choices, what does not vary."""

from __future__ import annotations

import numpy as np
import pytest

from holdfast.spatial.differentiation import bare, by_rule, gradient, linearised
from holdfast.spatial.linear import EachItem
from holdfast.spatial.scalar import arctan2, clip, cos, exp, maximum, minimum, sin, sqrt, tanh, where

STEP = 1e-6
FUNCTIONS = {
    "add": lambda a, b: a + b,
    "add a number": lambda a, b: 2.0 + a + 3.0 * b,
    "subtract": lambda a, b: a - b,
    "subtract from a number": lambda a, b: 2.0 - a - b,
    "multiply": lambda a, b: a * b,
    "divide": lambda a, b: a / b,
    "divide a number": lambda a, b: 2.0 / a + b / 4.0,
    "negate": lambda a, b: -a * b,
    "absolute": lambda a, b: abs(a) * abs(-b),
    "sqrt": lambda a, b: sqrt(a) * sqrt(b),
    "sin": lambda a, b: sin(a * b),
    "cos": lambda a, b: cos(a * b),
    "exp": lambda a, b: exp(a - b * b),
    "tanh": lambda a, b: tanh(a - b),
    "arctan2": lambda a, b: arctan2(a, -b) * arctan2(2.0, b) + arctan2(a, 3.0),
    "clip": lambda a, b: clip(a * b, 0.8, 1.2 * b),
    "where": lambda a, b: where(a < b, a * a, b) + where(a > b, b, b * b),
    "maximum": lambda a, b: maximum(a, b) * minimum(a, b) + maximum(a, b),
    "the same twice": lambda a, b: a * a * a + a * b,
}


def difference(f, *x: float) -> list[float]:
    """Return central differences."""
    found = []
    for k in range(len(x)):
        there, back = (list(x) for _ in range(2))
        there[k] += STEP
        back[k] -= STEP
        found.append((f(*there) - f(*back)) / (2 * STEP))
    return found


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("at", [(0.7, 1.3), (1.9, 0.4)])
def test_slopes(name, at):
    """Gradient and rates of each operation."""
    f = FUNCTIONS[name]
    expected = difference(f, *at)
    found = gradient(f, *at)
    assert [x.shape for x in found] == [(), ()]
    assert np.allclose(found, expected, rtol=1e-8, atol=1e-8)
    (rate,) = linearised(lambda a, b: (f(a, b),), *at).rates(2.0, -3.0)
    assert rate.shape == () and np.isclose(rate, 2.0 * expected[0] - 3.0 * expected[1], rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("x", [-2.0, -1e-3, 0.5])
def test_absolute(x):
    """The slope of |x| is its sign."""
    assert gradient(abs, x)[0] == np.sign(x)


def test_square_root_at_zero():
    """Its derivative there is 0, and nothing is divided by it."""
    with np.errstate(all="raise"):
        assert gradient(sqrt, 0.0)[0] == 0.0
        assert gradient(lambda x: sqrt(x @ x), np.zeros(3))[0].tolist() == [0.0] * 3
        (rate,) = linearised(lambda x: (sqrt(x),), 0.0).rates(1.0)
    assert rate == 0.0


def test_branch_taken():
    """Of two branches only the one taken has a part, and a condition none."""
    f = lambda x, y: where(x < 1.0, x * y, 1e9 * x)  # noqa: E731  (as short as the functions above)
    assert [float(g) for g in gradient(f, 0.5, 3.0)] == [3.0, 0.5]
    assert [float(g) for g in gradient(f, 2.0, 3.0)] == [1e9, 0.0]


def test_gradient_of_a_gradient():
    """The Hessian of a function, its rows and its product with a direction."""

    def f(x):
        return sin(x[0]) * x[1] * x[1] + x[0] / x[1]

    x, d = np.array([0.4, 1.7]), np.array([0.3, -0.9])
    hessian = np.array(
        [
            [-np.sin(x[0]) * x[1] ** 2, 2 * np.cos(x[0]) * x[1] - 1 / x[1] ** 2],
            [2 * np.cos(x[0]) * x[1] - 1 / x[1] ** 2, 2 * np.sin(x[0]) + 2 * x[0] / x[1] ** 3],
        ]
    )
    (rate,) = linearised(lambda x: gradient(f, x), x).rates(d)
    assert np.allclose(rate, hessian @ d, rtol=1e-13)
    rows = [gradient(lambda x, k=k: gradient(f, x)[0][k], x)[0] for k in range(2)]
    assert np.allclose(rows, hessian, rtol=1e-13)


def test_arrays_of_any_shape():
    """Matrices, numbers and empty arrays at once; gradients have their shapes."""
    random = np.random.default_rng(0)
    A, x, s, none = random.normal(size=(2, 3)), random.normal(size=3), np.array(0.7), np.zeros((0, 4))
    of_A, of_x, of_s, of_none = gradient(
        lambda A, x, s, none: (A @ x) @ np.ones(2) * s + sum(none.ravel()), A, x, s, none
    )
    assert np.allclose(of_A, float(s) * np.outer(np.ones(2), x))
    assert np.allclose(of_x, float(s) * A.sum(0))
    assert of_s.shape == () and np.isclose(float(of_s), (A @ x).sum())
    assert of_none.shape == (0, 4)


def test_what_does_not_depend():
    """It has gradients and rates of 0, in full shape; so has a constant."""
    of_a, of_b = gradient(lambda a, b: a[0] * 2.0, np.ones(2), np.ones((2, 2)))
    assert of_a.tolist() == [2.0, 0.0] and of_b.tolist() == [[0.0, 0.0], [0.0, 0.0]]
    assert gradient(lambda a: 5.0, np.ones(3))[0].tolist() == [0.0] * 3
    rates = linearised(lambda a, b: (np.eye(2), b), np.ones(2), np.ones(2)).rates(np.ones(2), np.array([1.0, 2.0]))
    assert rates[0].tolist() == [[0.0, 0.0], [0.0, 0.0]] and rates[1].tolist() == [1.0, 2.0]


def test_only_what_matters_is_kept():
    """Operations that no result depends on are not in the linear function."""

    def f(x):
        _ = [sin(x[k]) for k in range(3)]
        return (x[0] + x[1],)

    assert len(linearised(f, np.ones(3)).steps) == 1


def test_branches_are_refused():
    """Python's own `if` on a number that is varied says what to write instead."""
    with pytest.raises(TypeError, match="where"):
        gradient(lambda x: x if x else -x, 1.0)


class OfMatrix:
    """Derivatives of a function that are told: a matrix of a linear one."""

    def __init__(self, matrix: np.ndarray) -> None:
        self.matrix, self.asked = matrix, 0

    def rates(self, x):
        self.asked += 1
        return (self.matrix @ x,)

    def gradient(self, cotangent):
        self.asked += 1
        return (cotangent @ self.matrix,)


def test_rules():
    """A function whose derivatives a rule tells, between operations; asked only where something depends on it."""
    random = np.random.default_rng(4)
    A, x, d, cotangent = random.normal(size=(2, 3)), random.normal(size=3), random.normal(size=3), random.normal(size=2)
    rule, unused = OfMatrix(A), OfMatrix(A)

    def told(x):
        (y,) = by_rule([A @ bare(sin(x))], rule, sin(x))
        by_rule([A @ bare(x)], unused, x)
        return (y * y * x[:2],)

    def plain(x):
        return ((A @ sin(x)) ** 2 * x[:2],)

    found, expected = linearised(told, x), linearised(plain, x)
    assert np.allclose(found.rates(d), expected.rates(d), rtol=1e-14)
    assert np.allclose(found.gradient(cotangent), expected.gradient(cotangent), rtol=1e-14)
    assert rule.asked == 2 and unused.asked == 0
    (y,) = by_rule([A @ x], unused, x)  # of what is not varied
    assert y.dtype == float


def test_entries_of_a_result_depend_on_some_numbers_only():
    """What is left of a function, loops by their rule included, has the same gradients by fewer numbers."""

    def half(x):
        return linearised(lambda x: (np.array([x[0] * x[1], sin(x[1])]),), x)

    def function(x, scale):
        given = [x[:2], x[2:4]]
        values = [np.array([bare(a)[0] * bare(a)[1], np.sin(bare(a)[1])], dtype=float) for a in given]
        rule = EachItem(tuple([half(bare(a).astype(float)) for a in given]))
        first, second = by_rule(values, rule, *given)
        return (np.array([first[0] * scale[0], first[1], second[0] + second[1], 1.0]),)

    at = linearised(function, np.array([0.3, 0.7, 1.1, 0.2, 5.0]), np.array([2.0]))
    rows = [np.concatenate(at.gradient(row)) for row in np.eye(4)]
    # An item of a loop stays whole, with all numbers that it depends on.
    for entries, places in ((slice(0, 2), (0, 1, 5)), (slice(1, 2), (0, 1)), (slice(2, 3), (2, 3)), (slice(3, 4), ())):
        part, varied = at.of_entries(0, entries)
        assert varied == places
        assert len(part.steps) < len(at.steps)
        for k, row in enumerate(np.eye(entries.stop - entries.start)):
            expected = rows[entries.start + k]
            np.testing.assert_allclose(part.gradient(row)[0], expected[list(varied)], rtol=1e-15)
            assert not np.delete(expected, varied).any()
