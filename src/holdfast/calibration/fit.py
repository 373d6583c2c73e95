"""Weighted least squares over the unknowns, in which what is not determined keeps the model's values.

Unknowns are divided by their sizes: the standard deviation of the prior, or else `largest_deviation`. Eigenvectors of
H + prior with eigenvalues below 1 are the directions of which a standard deviation would exceed the size. They are not
determined, and x keeps the model's values along them. The covariance is the inverse of H + prior in the other
directions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from holdfast.calibration.estimated_noise import estimated_variances, freedoms_of_noise, require_shown
from holdfast.calibration.geometry import OpenGaps, adjusted
from holdfast.calibration.problem import RELATIVE_ROUNDING, FitPoint, Problem, Whitened, evaluated, whitened
from holdfast.identification.estimate import autocorrelation_of, huber_weights
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array

MOST_GAUSS_NEWTON, MOST_SHORTENINGS, MOST_WEIGHINGS, MOST_NULLS = 50, 12, 15, 4
FREE_SPREAD = 100.0  # sizes, the standard deviation of a free fit's unknowns: 1 rad, 1 m
LEAST_DECREASE = 1e-7  # decrease of the sum of squares, in variances, that ends the iteration
SAME_SPACE = 1e-2  # sine of the angle between subspaces that count as one
CALM = 0.02  # relative change of variances and weights that ends the rounds
FEWEST_IN_ORDER = 16  # postures in which neighbours may be found to depend on each other


@dataclass(frozen=True, eq=False)
class Fit(Frozen):
    """What was found.

    Attributes:
        x: (p,) corrections.
        covariance: (p, p) of x; 0 along `null`.
        information: (p, p) H, in sizes.
        null: (p, d) orthonormal directions, in sizes, that keep the model's values.
        weak: (p, d) directions of which the rows tell less than the size or the prior does.
        residuals: (postures, rows) gaps after the fit; NaN where a closure did not hold.
        noise: (channels,) standard deviations; then, if they were estimated, those of joints.
        freedoms: degrees of freedom by which estimated noise widens regions; infinite if it was given.
        misfit: mean square of whitened residuals.
        widening: by which the covariance was multiplied because neighbouring residuals depend on each other.
        weights: (postures,) weights of the postures; 1 unless robust.
        contradicted: standard deviations by which the model's values along `null` fit worse than others.
        settled: whether the iteration converged.
    """

    x: Array
    covariance: Array
    information: Array
    null: Array
    weak: Array
    residuals: Array
    noise: Array
    freedoms: float
    misfit: float
    widening: float
    weights: Array
    contradicted: float
    settled: bool


class _Solved(NamedTuple):
    at: FitPoint
    white: Whitened
    settled: bool


def fit(problem: Problem) -> Fit:
    """Return the estimate. O(steps postures rows^2 (p + n)).

    The free fit settles noise and weights; the estimate then keeps the model's values along what it leaves open.

    Raises:
        StateError: the gaps overflow, or too few rows are left to show the noise.
    """
    p = len(problem.sizes)
    prior, wide = np.diag(problem.known), problem.known + (1.0 - problem.known) / FREE_SPREAD**2
    weights, variances = np.ones(len(problem.q)), problem.first_variances()
    at, nothing, widening, calm = problem.start(np.zeros(p)), np.zeros((p, 0)), 1.0, False
    free = solved(problem, at, variances, weights, nothing, wide)
    if problem.noise is None:
        require_shown(problem, free.at, wide)
    for _ in range(MOST_WEIGHINGS):
        at, calm = free.at, True
        if problem.noise is None:
            estimated = estimated_variances(problem, at, variances, weights, wide)
            calm = calm and bool((np.abs(np.log(estimated / variances)) < CALM).all())
            variances = estimated
        if problem.robust:
            counted = _huber(problem, free.white, weights)
            calm = calm and bool((np.abs(counted - weights) < CALM).all())
            weights = counted
        if calm:
            break
        free = solved(problem, at, variances, weights, nothing, wide)
    if problem.noise is None and len(weights) >= FEWEST_IN_ORDER:
        widening = autocorrelation_of(free.white.left, 1).widening
    found, null = free, weak_directions(free.white.information / widening + prior)
    for _ in range(MOST_NULLS):
        found = solved(problem, at, variances, weights, null, problem.known)
        now = weak_directions(found.white.information / widening + prior)
        if same_space(null, now):
            break
        null = now
    H, kept = found.white.information / widening, complement(null)
    spread = kept @ np.linalg.inv(kept.T @ (H + prior) @ kept) @ kept.T
    rank = int(np.rint((found.white.U**2).sum()))
    freedoms = int(problem.active_rows.sum()) - rank - kept.shape[1] + int(problem.known.sum())
    squares = float((found.white.left**2).sum() + (problem.known * (found.at.x / problem.sizes) ** 2).sum())
    best = float((free.white.left**2).sum() + (problem.known * (free.at.x / problem.sizes) ** 2).sum())
    worse = (squares - best) / widening if null.shape[1] else 0.0
    return Fit(
        x=found.at.x,
        covariance=spread * np.outer(problem.sizes, problem.sizes),
        information=H,
        null=null,
        weak=weak_directions(H),
        residuals=np.where(problem.active_rows, evaluated(problem, found.at).gaps, np.nan),
        noise=np.sqrt(variances),
        freedoms=np.inf
        if problem.noise is not None
        else freedoms_of_noise(problem, found.white, spread, kept) / widening,
        misfit=squares / max(freedoms, 1),
        widening=widening,
        weights=weights,
        contradicted=float(np.sqrt(max(worse, 0.0))),
        settled=calm and found.settled,
    )


def solved(problem: Problem, at: FitPoint, variances: Array, weights: Array, null: Array, prior: Array) -> _Solved:
    """Return the point of least squares with given weights, which keeps the model's values along `null`.

    Gauss-Newton steps are halved until the sum of squares falls; `prior` (p,) are inverse variances of the unknowns, in
    sizes.
    """
    sizes = problem.sizes
    at = replace(at, x=at.x - sizes * (null @ (null.T @ (at.x / sizes))))
    kept = complement(null)
    white = whitened(problem, evaluated(problem, at), variances, weights)
    for _ in range(MOST_GAUSS_NEWTON):
        g, H = white.gradient + prior * at.x / sizes, white.information + np.diag(prior)
        step = -kept @ np.linalg.solve(kept.T @ H @ kept, kept.T @ g)
        inner = -(white.inverse @ (white.e + white.J @ step)[:, :, None])[:, :, 0]
        expected = float(-g @ step) + float(((white.e - white.left) ** 2).sum())
        cost = _cost(at.x / sizes, white, prior)
        if expected < LEAST_DECREASE * max(1.0, cost):
            return _Solved(at, white, True)
        for halving in range(MOST_SHORTENINGS):
            share = 0.5**halving
            tried = at.moved(problem, share * sizes * step, share * inner)
            new = whitened(problem, evaluated(problem, tried), variances, weights)
            if _cost(tried.x / sizes, new, prior) <= cost * (1.0 + 1e-9):
                break
        else:
            return _Solved(at, white, expected < 1e-3 * max(1.0, cost))
        at, white = tried, new
    return _Solved(at, white, False)


def settled(problem: Problem, x: Array) -> tuple[FitPoint, OpenGaps]:
    """Return the point and gaps with given corrections and the poses of free bodies that fit best."""
    layout = problem.layout
    frames = [
        replace(frame, pose=pose, unknowns=(), directions=np.zeros((6, 0)))
        for frame, (pose, _) in zip(layout.frames, adjusted(layout, x), strict=True)
    ]
    fixed = replace(layout, frames=tuple(frames), unknowns=())
    alone = replace(problem, layout=fixed, sizes=np.zeros(0), known=np.zeros(0))
    begun = alone.start(np.zeros(0))
    found = solved(alone, begun, problem.first_variances(), np.ones(len(problem.q)), np.zeros((0, 0)), np.zeros(0))
    return replace(found.at, x=x), evaluated(alone, found.at)


def _cost(x: Array, white: Whitened, prior: Array) -> float:
    return float((white.e**2).sum() + (prior * x**2).sum())


def weak_directions(H: Array) -> Array:
    """Return an orthonormal basis of the directions with eigenvalues below 1, (p, d)."""
    if not H.size:
        return np.zeros((0, 0))
    values, vectors = np.linalg.eigh(H)
    return vectors[:, (values < 1.0) | (values < RELATIVE_ROUNDING * values.max(initial=0.0))]


def complement(basis: Array) -> Array:
    """Return an orthonormal basis of what is orthogonal to another one, (p, p - d)."""
    return np.linalg.svd(basis, full_matrices=True)[0][:, basis.shape[1] :] if basis.size else np.eye(len(basis))


def same_space(a: Array, b: Array) -> bool:
    """Return whether two orthonormal bases span nearly the same space."""
    return a.shape == b.shape and bool(np.linalg.norm(b - a @ (a.T @ b)) < SAME_SPACE)


def _huber(problem: Problem, white: Whitened, weights: Array) -> Array:
    """Return weights of the postures: those of Huber, with robust=True."""
    freedoms = np.maximum(problem.active_rows.sum(axis=1) - (white.U**2).sum(axis=(1, 2)), 1.0)
    size = np.sqrt((white.left**2).sum(axis=1) / (np.maximum(weights, 1e-300) * freedoms))
    return huber_weights(size)
