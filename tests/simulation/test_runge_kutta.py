"""The Runge-Kutta schemes and their step, and the rate of a rotation vector."""

import mpmath
import numpy as np
import pytest
from scipy.integrate import DOP853

from holdfast.compiler.interpret import interpret
from holdfast.compiler.trace import trace
from holdfast.simulation.runge_kutta import MIDPOINT, RK4, SCHEMES, dop853, rotation_vector_rate, scheme
from holdfast.spatial import rotation
from tests.simulation.one_step import one_step

TABLEAUS = [RK4, MIDPOINT, dop853()]
tableaus = pytest.mark.parametrize("tableau", TABLEAUS, ids=lambda t: t.name)
X, Y, Z = np.eye(3)


def spinning(t, u):
    """Return the rate of a rotation vector that turns about a moving axis."""
    return rotation_vector_rate(u, np.array([np.sin(3 * t), 2.0, t]))


@tableaus
def test_order_conditions(tableau):
    """Stages are consistent, c = A 1, and quadrature is exact up to the order: sum b c^k = 1 / (k + 1)."""
    assert np.array_equal(tableau.a, np.tril(tableau.a, -1))
    np.testing.assert_allclose(tableau.a.sum(axis=1), tableau.c, atol=2e-15)
    moments = [tableau.b @ tableau.c**k for k in range(tableau.order + 1)]
    expected = 1 / (1 + np.arange(tableau.order + 1))
    np.testing.assert_allclose(moments[:-1], expected[:-1], atol=2e-15)
    assert abs(moments[-1] - expected[-1]) > 1e-6  # and no further


@pytest.mark.parametrize("name", SCHEMES)
def test_observed_order(name):
    """A frame that turns about a moving axis: halving the step divides the error by 2^order."""

    def attitude(tableau, steps):
        R, h = np.eye(3), 2.0 / steps
        for k in range(steps):
            R = rotation.exp(one_step(spinning, k * h, np.zeros(3), h, tableau)[0]) @ R
        return R

    exact = attitude(dop853(), 160)
    tableau = scheme(name)
    counts = (4, 8, 16) if name == "dop853" else (20, 40, 80)
    errors = np.array([np.abs(attitude(tableau, n) - exact).max() for n in counts])
    assert errors[-1] > 1e-14, "too small to see an order"
    orders = np.log2(errors[:-1] / errors[1:])
    assert orders.min() > tableau.order - 0.2, orders


@pytest.mark.parametrize("tableau", TABLEAUS[:2], ids=lambda t: t.name)
def test_exact_for_polynomials(tableau):
    """A right-hand side that is a polynomial of degree order - 1 in t is integrated exactly."""
    k, t, h = tableau.order, 0.3, 0.7
    y, errors = one_step(lambda t, y: np.array([k * t ** (k - 1) + 1]), t, np.array([2.0]), h, tableau)
    assert y[0] == pytest.approx(2.0 + (t + h) ** k - t**k + h, abs=1e-15)
    assert errors == []


def test_dop853_is_scipys():
    """One step of 0.1 s is the step of SciPy's own integrator; what it leaves out are weights of zero."""
    u, h = np.array([0.3, -0.2, 0.5]), 0.1
    theirs = DOP853(spinning, 0.7, u, 9.0, first_step=h, rtol=1e-3)
    theirs.step()
    assert theirs.t == 0.7 + h
    ours, _ = one_step(spinning, 0.7, u, h, dop853())
    np.testing.assert_allclose(ours, theirs.y, rtol=0, atol=1e-15)
    assert DOP853.E3[-1] == 0.0 and DOP853.E5[-1] == 0.0


@pytest.mark.parametrize(("row", "order"), [(0, 6), (1, 4)])
def test_orders_of_the_estimates(row, order):
    """The two estimates fall as h^6 and h^4."""
    u, steps = np.array([0.3, -0.2, 0.5]), np.array([0.4, 0.2, 0.1])
    sizes = [np.abs(one_step(spinning, 0.7, u, h, dop853())[1][row]).max() for h in steps]
    orders = np.log2(np.array(sizes[:-1]) / sizes[1:])
    assert np.abs(orders - order).max() < 0.6, orders
    assert dop853().error[row].sum() == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("angle", [0.0, 1e-6, 0.999e-3, 1.001e-3, 0.5, 3.0, 6.0])
def test_rotation_vector_rate_turns_at_w(angle):
    """d/dt exp(u) = w~ exp(u) along the returned rate, for small and large u."""
    rng = np.random.default_rng(3)
    axis, w = rng.normal(size=(2, 3))
    u = angle * axis / np.linalg.norm(axis)
    rate, h = rotation_vector_rate(u, w), 1e-6
    turned = rotation.exp(u + h * rate) @ rotation.exp(u - h * rate).T
    assert rotation.log(turned) / (2 * h) == pytest.approx(w, abs=1e-8)


@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-160, 1e-12, 1e-5, 9.99e-4, 1.001e-3, 1e-2, 0.3, 2.0, 5.0])
def test_rotation_vector_rate_keeps_its_digits(angle):
    """To rounding of the formula in 50 digits, down to no rotation at all."""
    u, w = angle * np.array([0.6, 0.0, 0.8]), np.array([0.3, -2.0, 0.7])
    with mpmath.workdps(50):
        a = mpmath.mpf(angle) * mpmath.sqrt(mpmath.mpf(0.6) ** 2 + mpmath.mpf(0.8) ** 2)
        c = (1 - a / 2 * mpmath.cot(a / 2)) / a**2 if angle > 1e-20 else mpmath.mpf(1) / 12
        turned = np.cross(u.astype(object) * mpmath.mpf(1), w)
        exact = (w - turned / 2 + c * np.cross(u, turned)).astype(float)
    np.testing.assert_allclose(rotation_vector_rate(u, w), exact, rtol=0, atol=1e-15 * max(1.0, angle**2))


@tableaus
def test_traced(tableau):
    """The step can be traced: interpreted it gives the numbers of floats, at rest too."""

    def step(t, u, h):
        y, errors = one_step(lambda t, u: rotation_vector_rate(u, t * X + 2.0 * Y), t[()], u, h[()], tableau)
        return y, *errors

    program = trace(step, [(), (3,), ()])
    for u in (np.zeros(3), np.array([0.2, -0.1, 0.4])):
        found = interpret(program, 0.4, u, 0.1)
        for x, y in zip(found, step(np.array(0.4), u, np.array(0.1)), strict=True):
            np.testing.assert_allclose(x, y, rtol=0, atol=1e-15)
