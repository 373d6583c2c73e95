"""Explicit Runge-Kutta schemes as tableaus, and the step that is common to all of them.

An attitude is written R = exp(u) R_0 relative to the attitude R_0 at the step's start. The step therefore adds vectors,
and the result is always a rotation (Munthe-Kaas).
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
        name: name of the scheme, as in `SCHEMES`.
        order: order of y(t + h) = y + h sum_i b_i k_i; the error of one step is O(h^(order + 1)).
        c: (s,) stage times as fractions of the step, c_0 = 0.
        a: (s, s) weights of the stages, strictly lower triangular.
        b: (s,) weights of the step.
        error: (estimates, s) weights e of the error estimates h sum_i e_i k_i; (0, s) for a scheme without an estimate.
        a_implicit: (s, s) implicit weights, lower triangular, of a scheme that is implicit in the damping and springs
            of joints (`linearly_implicit`); None for an explicit scheme.
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
        """Whether steps are implicit in the damping and springs of joints."""
        return self.a_implicit is not None

    @functools.cached_property
    def stability_interval(self) -> float:
        """The largest x such that steps of y' = -rate y with h rate <= x do not grow: 2 for midpoint, 2.785 for rk4.

        For a linearly implicit scheme, this is the limit for the forces that it treats explicitly.
        A step multiplies y by R(-h rate), R(z) = 1 + sum_k b^T A^(k-1) 1 z^k; this is the first x with |R(-x)| = 1.
        """
        terms, weights = [], -self.b  # coefficients of (-x)^k, k = 1 .. s
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

# The cheapest scheme. Simulators often use semi-implicit Euler, which conserves energy well if the inertia does not
# depend on the configuration; here it does. For two Pandas that fall for 0.4 s, with two evaluations per millisecond,
# the energy drifts by 2e-6 of the peak kinetic energy with the midpoint rule, and by 5e-4 with semi-implicit Euler.
# Moreover, the midpoint rule needs half as many projections, each of which costs as much as two evaluations.
MIDPOINT = Tableau(
    "midpoint", 2, np.array([0.0, 0.5]), np.array([[0.0, 0.0], [0.5, 0.0]]), np.array([0.0, 1.0]), np.zeros((0, 2))
)


def _imex() -> Tableau:
    """Return an implicit-explicit scheme with three stages and order 2.

    The explicit stages, at 0, 1/3 and 1, have weights b of order 3. The implicit part has the same weights, which are
    also those of its last stage, at the end of the step. Its second and third stages do not use the first, and their
    weights sum up to 1/3 and 1: both parts of a stage are at the same time, so that the stages have the correct
    acceleration under a force that varies linearly with time, for any damping. Their stability function,
    R(z) = (1 + 5 z / 12) / ((1 - z / 3)(1 - z / 4)), is that of an L-stable scheme of order 2. The first stage, whose
    rates still contain the modes that decay at once, has weight zero and only predicts the states of the others.
    """
    explicit = np.array([[0.0, 0.0, 0.0], [1 / 3, 0.0, 0.0], [-1.0, 2.0, 0.0]])
    b = np.array([0.0, 3 / 4, 1 / 4])
    implicit = np.array([[1 / 3, 0.0, 0.0], [0.0, 1 / 3, 0.0], b])
    return Tableau("imex", 2, np.array([0.0, 1 / 3, 1.0]), explicit, b, np.zeros((0, 3)), implicit)


IMEX = _imex()

# One stage, for steps of length zero, which only project and evaluate the state.
EULER = Tableau("euler", 1, np.zeros(1), np.zeros((1, 1)), np.ones(1), np.zeros((0, 1)))


@functools.cache
def dop853() -> Tableau:
    """Return the scheme of Dormand and Prince of order 8 with twelve stages, and Hairer's two error estimates.

    The estimates are of orders 5 and 3; `Tolerance.ratio` combines them. The coefficients are those of SciPy.
    """
    from scipy.integrate import DOP853  # slow to import

    s = DOP853.n_stages
    # the last weight in SciPy belongs to the first stage of the next step, and is zero
    error = np.array([DOP853.E5[:s], DOP853.E3[:s]])
    return Tableau("dop853", 8, DOP853.C[:s].copy(), DOP853.A[:s, :s].copy(), DOP853.B.copy(), error)


def scheme(name: str) -> Tableau:
    """Return the scheme with the given name.

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
    """Return the increment of y in a step of y' = f(t, y), and the estimates of its error.

    This is a generator that requests the slopes: it yields the request that `stage` returns for a stage, and the caller
    sends the slope f at that stage.

    Args:
        first: (m,) f at the start of the step.
        step: h [s].
        tableau: the scheme.
        stage: function of i and the increment of y that returns the request for stage i, at t + c_i h.

    Returns:
        The increment (m,), and one estimate (m,) per row of `tableau.error`.
    """
    slopes = [first]
    for i, row in enumerate(tableau.a[1:], start=1):
        slopes.append((yield stage(i, step * weighted(row, slopes))))
    return step * weighted(tableau.b, slopes), [step * weighted(e, slopes) for e in tableau.error]


def weighted(weights: Array, slopes: Sequence[Array]) -> Array:
    """Return sum_i w_i k_i over the nonzero weights, of which there is at least one."""
    first, *others = [float(w) * k for w, k in zip(weights, slopes, strict=False) if w != 0.0]
    return sum(others, first)


def rotation_vector_rate(u: Array, w: Array) -> Array:
    """Return u' for R = exp(u) R_0 with the angular velocity w [rad/s], world axes.

    u' = w - u x w / 2 + c u x (u x w), c = (1 - (a/2) cot(a/2)) / a^2, a = |u| < 2 pi.
    """
    square = u @ u
    small = square < 1e-6
    series = 1 / 12 + square / 720  # exact to the last digit for small angles
    safe = where(small, 1.0, square)  # both branches are evaluated, so neither may divide by zero
    half = 0.5 * sqrt(safe)
    c = where(small, series, (1.0 - half * cos(half) / sin(half)) / safe)
    turned = cross(u, w)
    return w - 0.5 * turned + c * cross(u, turned)
