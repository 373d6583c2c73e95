"""Smoothing splines for recorded positions, with as much smoothing as their noise calls for.

A column of samples y = Phi c + noise is fitted by a spline of degree 7 whose fourth derivative is penalised,

    min |y - Phi c|^2 + lambda int (x'''')^2 dt

which is the posterior mean if the noise is white and the fourth derivative is white, too (Wahba 1978). lambda and the
standard deviation of the noise have the greatest restricted likelihood. In motions that rest and then swing the fourth
derivative is not the same throughout: one lambda flattens peaks and leaves noise in rests. A second fit has
lambda / s(t), with the relative size s of the squared fourth derivative near t in the first fit, and is taken if it is
more likely. The errors of the fit and of its derivatives have the covariance sigma^2 L A^-1 L^T, where
A = Phi^T Phi + lambda P and L evaluates them. They are not correlated with the fitted values, so that equations made of
these are not biased towards zero, as those of noisy values are. Exact positions are interpolated, since their lambda is
negligible.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded
from scipy.ndimage import uniform_filter1d
from scipy.optimize import minimize_scalar
from scipy.sparse import csr_array, diags_array

from holdfast.spatial.scalar import Array

SPLINE_DEGREE, PENALISED = 7, 4  # of the spline; of the penalised derivative
FEWEST_KNOTS = 24  # spans of a spline below which its knots are not thinned
SMOOTHEST = 1e4  # lambda, in spans, above which every second knot is dropped: float64 would not resolve it
NEAR = 9  # spans over which sizes of the penalised derivative are averaged, twice
LEAST_SIZE = 0.01  # that is added to these sizes, in units of their mean
LIKELIER = 4.0  # twice the logarithm of the likelihood that uneven smoothing must gain
LAMBDAS = np.arange(-10.0, 8.1)  # decimal logarithms that are tried first
PERIODS = 2  # of the frequency at which the spline filters, after which its errors are independent
OFF_STEPS = 1e-3  # largest deviation of positions from multiples of an encoder's step, in steps
ROUNDED_STEPS = 1e-9  # steps below this fraction of the range are rounding of the file
EXACT_POSITIONS = 1e-13  # noise below this fraction of the range is rounding of the numbers


@dataclass(frozen=True, eq=False)
class Spline:
    """A smoothing spline through a column of samples.

    Attributes:
        values: (3, samples) the fit, its first and its second derivative.
        noise: standard deviation of the samples; 0 if they are exact.
        evaluations: sparse matrices (samples, K), from coefficients to the values and each derivative.
        triangle: banded Cholesky factor of A.
        memory: samples over which the errors of the fit depend on each other.
    """

    values: Array
    noise: float
    evaluations: list[csr_array]
    triangle: Array
    memory: int

    def covariance(self, weights: Array) -> Array:
        """Return B^T sigma^2 A^-1 B for combinations B, (K, k), of the coefficients."""
        return self.noise**2 * weights.T @ cho_solve_banded((self.triangle, True), weights)


def smoothing_spline(t: Array, y: Array) -> Spline:
    """Return the smoothing spline through samples y at times t, (samples,) each. O(samples)."""
    unit = float(t[-1] - t[0]) / (len(t) - 1)
    times, size = (t - t[0]) / unit, float(np.ptp(y))
    step = encoder_step(y)
    stride = 1
    while True:
        fit = _Fit(times, (y - y.mean()) / (size or 1.0), stride, step / np.sqrt(12.0) / (size or 1.0))
        if fit.smoothing[0] < SMOOTHEST or len(t) / (2 * stride) < FEWEST_KNOTS:
            break
        stride *= 2
    values = np.array([E @ fit.coefficients for E in fit.evaluations]) * size
    values[0] += y.mean()
    scales = [1.0, unit, unit**2]
    evaluations = [csr_array(E / s) for E, s in zip(fit.evaluations, scales, strict=True)]
    memory = int(np.ceil(PERIODS * 2.0 * np.pi * fit.smoothing[1] ** (0.5 / PENALISED) * stride))
    noise = fit.noise if fit.noise > EXACT_POSITIONS else 0.0
    return Spline(values / np.array(scales)[:, None], noise * size, evaluations, fit.triangle, memory)


class _Fit:
    """The spline with the most likely smoothing, for samples of unit range and mean distance.

    Attributes:
        smoothing: lambda with lengths in spans of the spline, and where it is largest.
        noise: standard deviation of the samples.
        coefficients: (K,) c.
        evaluations: as those of `Spline`.
        triangle: as that of `Spline`.
    """

    def __init__(self, t: Array, y: Array, stride: int, least_noise: float) -> None:
        spans = max(len(t) - SPLINE_DEGREE, 1) if stride == 1 else max(len(t) // stride, 1)
        inner = np.interp(np.linspace(0.0, len(t) - 1.0, spans + 1), np.arange(len(t)), t)
        knots = np.concatenate([[t[0]] * SPLINE_DEGREE, inner, [t[-1]] * SPLINE_DEGREE])
        width = (t[-1] - t[0]) / spans
        self.evaluations = [evaluation(knots, t, k) for k in range(3)]
        self._y, self._least = y, least_noise
        Phi, bent = self.evaluations[0], csr_array(bending(knots) * width ** (PENALISED - 0.5))
        self._gram = banded(csr_array(Phi.T @ Phi), len(knots) - SPLINE_DEGREE - 1)
        self._right = Phi.T @ y
        cost, best = self._likeliest(bent)
        self.smoothing = 10.0**best, 10.0**best
        chosen = self._solved(best)
        squares = ((bent @ chosen[2]) ** 2).reshape(-1, PENALISED).sum(axis=1)
        if chosen[1] > EXACT_POSITIONS and squares.any():
            near = uniform_filter1d(uniform_filter1d(squares, NEAR, mode="nearest"), NEAR, mode="nearest")
            sizes = near / near.mean() + LEAST_SIZE
            sizes /= np.exp(np.log(sizes).mean())
            other, best = self._likeliest(csr_array(diags_array(np.repeat(sizes, PENALISED) ** -0.5) @ bent))
            if other < cost - LIKELIER:
                self.smoothing = 10.0**best, 10.0**best / float(sizes.min())
                chosen = self._solved(best)
        _, self.noise, self.coefficients, self.triangle = chosen

    def _likeliest(self, bent: csr_array) -> tuple[float, float]:
        """Return the least cost for a root of the penalty, and the logarithm of the lambda that has it."""
        self._bent, self._penalty = bent, banded(csr_array(bent.T @ bent), len(self._right))
        costs = [self._solved(x)[0] for x in LAMBDAS]
        best = float(LAMBDAS[int(np.argmin(costs))])
        bounds = (best - 1.0, best + 1.0)
        found: Any = minimize_scalar(lambda x: self._solved(x)[0], bounds=bounds, method="bounded")
        return (float(found.fun), float(found.x)) if found.fun < min(costs) else (min(costs), best)

    def _solved(self, exponent: float) -> tuple[float, float, Array, Array]:
        """Return minus twice the restricted log likelihood, the noise, c and the factor of A, for a lambda.

        The first is infinite where float64 does not tell A from a singular matrix, as with little smoothing over a gap.
        """
        weight = 10.0**exponent
        try:
            L = cholesky_banded(self._gram + weight * self._penalty, lower=True)
        except LinAlgError:
            return np.inf, np.nan, np.empty(0), np.empty((0, 0))
        c = cho_solve_banded((L, True), self._right)
        rest = self._y - self.evaluations[0] @ c
        bent = self._bent @ c
        total, count = float(rest @ rest) + weight * float(bent @ bent), len(rest) - PENALISED
        variance = max(total / count, self._least**2, 1e-32)
        cost = count * np.log(variance) + total / variance + 2.0 * np.log(L[0]).sum()
        return float(cost - (len(c) - PENALISED) * np.log(weight)), float(np.sqrt(variance)), c, L


def evaluation(knots: Array, t: Array, derivative: int) -> csr_array:
    """Return the sparse matrix (len(t), K) from the coefficients of a spline to a derivative at times t."""
    degree, change = SPLINE_DEGREE, None
    for _ in range(derivative):
        spans = knots[degree + 1 : -1] - knots[1 : -degree - 1]
        shape: Any = (len(spans), len(spans) + 1)
        one = diags_array(-degree / spans, offsets=0, shape=shape) + diags_array(degree / spans, offsets=1, shape=shape)
        change = one if change is None else one @ change
        knots, degree = knots[1:-1], degree - 1
    values = BSpline.design_matrix(t, knots, degree)
    return csr_array(values if change is None else values @ change)


def bending(knots: Array) -> csr_array:
    """Return a sparse root (.., K) of the integral of the squared fourth derivative, exact by Gauss points."""
    points, weights = np.polynomial.legendre.leggauss(PENALISED)
    inner = knots[SPLINE_DEGREE:-SPLINE_DEGREE]
    half = 0.5 * np.diff(inner)
    t = (inner[:-1] + half)[:, None] + half[:, None] * points
    return csr_array(diags_array(np.sqrt(half[:, None] * weights).ravel()) @ evaluation(knots, t.ravel(), PENALISED))


def banded(matrix: csr_array, size: int) -> Array:
    """Return the lower bands (SPLINE_DEGREE + 1, size) of a symmetric banded matrix."""
    found = np.zeros((SPLINE_DEGREE + 1, size))
    for k in range(min(SPLINE_DEGREE + 1, size)):
        found[k, : size - k] = matrix.diagonal(-k)
    return found


def encoder_step(y: Array) -> float:
    """Return the step of which all samples are multiples, or 0.0 if there is none."""
    levels = np.unique(y)
    if len(levels) < 3:
        return 0.0
    step = float(np.diff(levels).min())
    multiples = (levels - levels[0]) / step
    whole = np.abs(multiples - multiples.round()).max() < OFF_STEPS
    return step if whole and step > ROUNDED_STEPS * (levels[-1] - levels[0]) else 0.0
