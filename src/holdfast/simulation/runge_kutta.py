"""Explicit Runge-Kutta schemes as data, and one step for all, on rotation vectors where there is a rotation.

An attitude is written R = exp(u) R_0 about the attitude R_0 at the step's start, so the
step adds plain vectors and never leaves the rotation group (Munthe-Kaas).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array, Scalar, cos, sin, sqrt, where
from holdfast.spatial.vector import cross

SCHEMES = ("rk4", "midpoint", "dop853", "imex")


@dataclass(frozen=True, eq=False)
class Tableau(Frozen):
    """A Runge-Kutta scheme of s stages, k_i = f(t + c_i h, y + h sum_j<i a_ij k_j), or an implicit-explicit one.

    Attributes:
        name: as in `SCHEMES`.
        order: of y(t + h) = y + h sum_i b_i k_i; the error of one step is O(h^(order + 1)).
        c: (s,) stage times in steps, c_0 = 0.
        a: (s, s) strictly lower triangular.
        b: (s,).
        error: (estimates, s) weights e of the error estimates h sum_i e_i k_i; (0, s) for a
            scheme that estimates none.
        a_implicit: (s, s) lower triangular, of a scheme that is implicit in damping and springs of joints
            (`linearly_implicit`); None for an explicit one.
    """

    name: str
    order: int
    c: Array
    a: Array
    b: Array
    error: Array
    a_implicit: Array | None = None

    @property
    def adaptive(self) -> bool:
        """Whether a step comes with an estimate of its error."""
        return len(self.error) > 0

    @property
    def implicit(self) -> bool:
        """Whether steps are implicit in damping and springs of joints."""
        return self.a_implicit is not None

    @functools.cached_property
    def stability_interval(self) -> float:
        """The largest x such that steps of y' = -rate y with h rate <= x do not grow: 2 for midpoint, 2.785 for rk4.

        Of a linearly implicit method, for what it does not take implicitly.
        A step multiplies y by R(-h rate), R(z) = 1 + sum_k b^T A^(k-1) 1 z^k; this is the first x with |R(-x)| = 1.
        """
        terms, weights = [], -self.b  # of (-x)^k, k = 1 .. s
        for _ in self.b:
            terms.append(float(weights.sum()))
            weights = -weights @ self.a
        growth = np.polynomial.Polynomial(terms)  # (R(-x) - 1) / x
        beyond = [growth, 2.0 + growth * np.polynomial.Polynomial([0.0, 1.0])]  # zero where R = 1, R = -1
        roots = np.concatenate([one.trim(1e-15).roots() for one in beyond])
        return float(min(x.real for x in roots if abs(x.imag) < 1e-9 and x.real > 0.0))


RK4 = Tableau(
    "rk4",
    4,
    np.array([0.0, 0.5, 0.5, 1.0]),
    np.array([[0.0, 0.0, 0.0, 0.0], [0.5, 0.0, 0.0, 0.0], [0.0, 0.5, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]),
    np.array([1 / 6, 1 / 3, 1 / 3, 1 / 6]),
    np.zeros((0, 4)),
)

# The cheap scheme. Simulators often take semi-implicit Euler, which keeps energy well where the
# inertia does not depend on the configuration; here it does. On two Pandas that fall for 0.4 s the
# midpoint rule drifts by 2e-6 of the peak kinetic energy with 2 evaluations a ms, semi-implicit
# Euler with as many by 5e-4; and projection, which costs as much as both, is needed half as often.
MIDPOINT = Tableau(
    "midpoint",
    2,
    np.array([0.0, 0.5]),
    np.array([[0.0, 0.0], [0.5, 0.0]]),
    np.array([0.0, 1.0]),
    np.zeros((0, 2)),
)


def _imex() -> Tableau:
    """Return an implicit-explicit scheme of three stages and order 2.

    The explicit stages, at 0, 1/3 and 1, have weights b of order 3. The implicit ones have the same weights, which are
    their last stage's, the step's end; they are of order 2, and L-stable, as are all such schemes with a diagonal g
    of at least 0.181. With g = 1/4 nothing weighs the first stage, where what decays at once is still in the rates.
    """
    explicit = np.array([[0.0, 0.0, 0.0], [1 / 3, 0.0, 0.0], [-1.0, 2.0, 0.0]])
    b = np.array([0.0, 3 / 4, 1 / 4])
    implicit = np.array([[1 / 4, 0.0, 0.0], [1 / 12, 1 / 4, 0.0], b])
    return Tableau("imex", 2, np.array([0.0, 1 / 3, 1.0]), explicit, b, np.zeros((0, 3)), implicit)


IMEX = _imex()

# One stage, for steps of length zero, of which only the end is of interest.
EULER = Tableau("euler", 1, np.zeros(1), np.zeros((1, 1)), np.ones(1), np.zeros((0, 1)))


@functools.cache
def dop853() -> Tableau:
    """Return the pair of Dormand and Prince of order 8, twelve stages, with Hairer's two error estimates.

    The estimates are of orders 5 and 3; `Tolerance.ratio` puts them together. The numbers are SciPy's.
    """
    from scipy.integrate import DOP853  # slow to import

    s = DOP853.n_stages
    # SciPy's last weight belongs to the next step's first stage, and is zero
    error = np.array([DOP853.E5[:s], DOP853.E3[:s]])
    return Tableau("dop853", 8, DOP853.C[:s].copy(), DOP853.A[:s, :s].copy(), DOP853.B.copy(), error)


def scheme(name: str) -> Tableau:
    """Return the scheme of a name.

    Raises:
        ModelError: no scheme has that name.
    """
    for tableau in (RK4, MIDPOINT, IMEX):
        if name == tableau.name:
            return tableau
    if name == "dop853":
        return dop853()
    raise ModelError(f"simulation: scheme: no '{name}'.{checks.did_you_mean(name, SCHEMES)}")


def runge_kutta_step(
    first: Array, step: Scalar, tableau: Tableau, stage: Callable[[int, Array], Any]
) -> Generator[Any, Array, tuple[Array, list[Array]]]:
    """Return by how much y grows in a step of y' = f(t, y), and the estimates of its error.

    A generator, which asks for the slopes: it yields what `stage` makes of a stage, and is sent f there.

    Args:
        first: (m,) f where the step begins.
        step: h [s].
        tableau: the scheme.
        stage: (i, increment of y) -> what is asked; the i-th stage is at t + c_i h.

    Returns:
        (m,) the increment, and per row of `tableau.error` an estimate (m,).
    """
    slopes = [first]
    for i, row in enumerate(tableau.a[1:], start=1):
        slopes.append((yield stage(i, step * weighted(row, slopes))))
    return step * weighted(tableau.b, slopes), [step * weighted(e, slopes) for e in tableau.error]


def weighted(weights: Array, slopes: Sequence[Array]) -> Array:
    """Return sum_i w_i k_i over the weights that are not zero; there is one."""
    first, *others = [float(w) * k for w, k in zip(weights, slopes, strict=False) if w != 0.0]
    return sum(others, first)


def rotation_vector_rate(u: Array, w: Array) -> Array:
    """Return u' for R = exp(u) R_0 that turns at w [rad/s], world axes.

    u' = w - u x w / 2 + c u x (u x w), c = (1 - (a/2) cot(a/2)) / a^2, a = |u| < 2 pi.
    """
    square = u @ u
    small = square < 1e-6
    series = 1 / 12 + square / 720  # exact to the last digit there
    safe = where(small, 1.0, square)  # both branches are evaluated: neither may divide by zero
    half = 0.5 * sqrt(safe)
    c = where(small, series, (1.0 - half * cos(half) / sin(half)) / safe)
    turned = cross(u, w)
    return w - 0.5 * turned + c * cross(u, turned)
