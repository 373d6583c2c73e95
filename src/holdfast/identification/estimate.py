"""Weighted least squares over physically possible bodies; unidentifiable combinations keep the model's values.

The whitened rows are reduced to a triangle R (QR). With each unknown scaled by its size, the singular values of R are
the inverses of the standard deviations of combinations of unknowns. Combinations with a standard deviation below a
limit are estimated. The others, Q, are fixed,

    min |R features(x)|^2    with    Q^T (xi - xi_model) / sizes = 0

over log-Cholesky parameters, so that every iterate is a possible body. With Z, a basis of the changes that leave the
fixed combinations unchanged,

    cov = Z G^-1 (sum_blocks u u^T) G^-1 Z^T,    u = Z^T sum J^T e,   G = Z^T J^T J Z

which is valid for any distribution of the noise, even if the weights are wrong (White 1980). With given noise,
cov = Z G^-1 Z^T. Blocks are as long as the residuals are correlated from sample to sample.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from holdfast.errors import StateError
from holdfast.identification.equations import Equations
from holdfast.identification.noise import channel_sizes, estimated, whitener
from holdfast.identification.unknowns import Unknowns
from holdfast.model import checks
from holdfast.spatial.inertia import of_parameters
from holdfast.spatial.log_cholesky import numbers_of
from holdfast.spatial.scalar import Array

HARDLY = 0.01  # initial guess of the noise, relative to the measurements
ROUNDS = 3  # alternations of weights and estimate
FIRM = 1e3  # weight of the fixed combinations, relative to the largest singular value
NARROWEST = 5.0  # largest deviation from the model of the log-Cholesky parameters for the spread of mass
MOST_STEPS, MOST_HALVINGS = 100, 30
NO_GAIN = 1e-8  # smallest decrease of the sum of squares, whose terms are about 1, that counts as progress
BOUNDED = 1e-2  # if an impossible body decreases that sum by more than this, the estimate is on the bound
CORRELATED = 0.1  # correlation of successive samples above which samples are combined into blocks
LEAST_LEFT = 0.05  # lower bound of 1 - h, which is near 0 if one sample alone determines a coefficient


@dataclass(frozen=True, eq=False)
class Estimate:
    """An estimate and its uncertainty.

    Attributes:
        plain: (p,) the estimate xi.
        covariance: (p, p) covariance of xi; 0 along the fixed combinations.
        fixed: (p, d) orthonormal basis of the combinations that keep the model's values, with unknowns scaled by size.
        residuals: (samples, r) residuals of the rows.
        noise: (channels,) standard deviations that define the weights.
        misfit: mean square of the whitened residuals, which is 1 if the noise has these standard deviations.
        correlation: correlation of the whitened residuals of successive samples; 0 if it is not significant.
        possible: whether the unconstrained minimum is a physically possible body.
    """

    plain: Array
    covariance: Array
    fixed: Array
    residuals: Array
    noise: Array
    misfit: float
    correlation: float
    possible: bool


def estimate(system: Equations, unknowns: Unknowns, kinds: Array, given: Array | None, largest: float) -> Estimate:
    """Return the estimate.

    Args:
        system: the equations.
        unknowns: the unknowns.
        kinds: (channels,) labels; channels with the same label have the same noise.
        given: (channels,) standard deviations of the noise; None to estimate them.
        largest: standard deviation of a combination, relative to its size, above which it is not estimated.
    """
    for x in (system.rows, system.measured, system.maps):
        checks.finite(x, "identify: recordings")
    sizes = channel_sizes(system.measured, kinds)
    noise, theta = HARDLY * sizes if given is None else given, unknowns.start
    fixed, rows = np.zeros((0, 0)), system.rows
    for _ in range(ROUNDS if given is None else 1):
        W = whitener(system.maps, noise)
        rows = W @ system.rows
        _, R = np.linalg.qr(rows.reshape(-1, rows.shape[2]))
        fixed, identified = combinations(
            R @ unknowns.features(unknowns.linear(theta))[1] * unknowns.linear_sizes, largest
        )
        theta = solved(R, unknowns, fixed, identified)
        values = unknowns.features(unknowns.linear(theta))[0]
        if given is None:
            noise = estimated(W @ system.maps, rows @ values, kinds, sizes)
    if fixed.shape[0] == fixed.shape[1]:
        raise StateError(
            "identify: expected a recording that identifies some part of the payload, got one in which all its effects"
            " are below the noise; try larger and faster motions, above all rotations"
        )
    values, slopes = unknowns.features(unknowns.linear(theta))
    e, J = rows @ values, rows @ slopes * unknowns.linear_sizes
    correlation = float((e[1:] * e[:-1]).sum() / max((e * e).sum(), 1e-300))
    if correlation < max(CORRELATED, 3.0 / np.sqrt(e.size)):  # not significant
        correlation = 0.0
    to_x, to_plain = unknowns.slopes(theta)
    try:
        inverse = np.linalg.inv(to_x)
    except np.linalg.LinAlgError as cause:
        raise StateError(
            "identify: expected a recording that some payload explains, got one whose estimate has no uncertainty in"
            " float64; check the units and signs of the wrenches and torques"
        ) from cause
    change = (to_plain @ inverse) * unknowns.linear_sizes / unknowns.sizes[:, None]
    Z = null_space(fixed.T @ change)
    pull = np.einsum("srj,sr->j", J @ Z, e)  # zero unless the estimate is on the bound of possible bodies
    gain = float(pull @ np.linalg.solve(np.einsum("srj,srk->jk", J @ Z, J @ Z), pull))
    spread = change @ Z @ variance(J @ Z, e, correlation, given is not None) @ Z.T @ change.T
    covariance = spread * np.outer(unknowns.sizes, unknowns.sizes)
    freedoms = max(e.size - Z.shape[1], 1)
    misfit = float((e * e).sum()) / freedoms
    left = system.rows @ values
    checks.finite(np.append(covariance, left), "identify: the estimate")
    return Estimate(unknowns.plain(theta), covariance, fixed, left, noise, misfit, correlation, gain < BOUNDED)


def combinations(J: Array, largest: float) -> tuple[Array, Array]:
    """Return bases of the combinations that cannot be identified, (p, d), and of those that can, (p, k)."""
    checks.finite(J, "identify: what the recordings tell")
    _, singular, Vt = np.linalg.svd(J, full_matrices=True)
    count = int((singular * largest >= 1.0).sum())
    return Vt[count:].T, Vt[:count].T


def solved(R: Array, unknowns: Unknowns, fixed: Array, identified: Array) -> Array:
    """Return theta of the physically possible body with the least sum of squares.

    Args:
        R: (.., features) triangle of the whitened rows.
        unknowns: the unknowns.
        fixed: basis of the combinations that keep the model's values.
        identified: basis of the other combinations.
    """
    firm = FIRM * float(np.linalg.norm(R[:, :10] * unknowns.linear_sizes[:10], ord=2)) or 1.0

    def rows_at(theta: Array) -> Array:
        off = (unknowns.plain(theta) - unknowns.model) / unknowns.sizes
        return np.concatenate([R @ unknowns.features(unknowns.linear(theta))[0], firm * (fixed.T @ off)])

    def slopes_at(theta: Array) -> Array:
        to_x, to_plain = unknowns.slopes(theta)
        of_rows = R @ unknowns.features(unknowns.linear(theta))[1] @ to_x
        return np.vstack([of_rows, firm * fixed.T @ (to_plain / unknowns.sizes[:, None])])

    start = unknowns.start
    values, slopes = unknowns.features(unknowns.linear(start))
    J = R @ slopes * unknowns.linear_sizes
    step = -identified @ (np.linalg.pinv(J @ identified) @ (R @ values))
    x = unknowns.linear(start) + step * unknowns.linear_sizes
    begin = start
    with contextlib.suppress(ValueError):  # the step leads to an impossible body
        begin = np.concatenate([numbers_of(of_parameters(x[:10])), x[10:]])
    width = np.full(len(start), np.inf)
    width[1:4] = NARROWEST
    return gauss_newton(rows_at, slopes_at, begin, start - width, start + width)


def gauss_newton(
    rows_at: Callable[[Array], Array], slopes_at: Callable[[Array], Array], theta: Array, low: Array, high: Array
) -> Array:
    """Return the minimiser of the whitened rows within bounds; as they are nearly linear, a few steps suffice."""
    theta = np.clip(theta, low, high)
    rows = rows_at(theta)
    for _ in range(MOST_STEPS):
        J = slopes_at(theta)
        step = np.linalg.lstsq(J, -rows, rcond=1e-13)[0]
        outward = ((theta <= low) & (step < 0.0)) | ((theta >= high) & (step > 0.0))
        if outward.any():
            step = np.where(outward, 0.0, np.linalg.lstsq(J * ~outward, -rows, rcond=1e-13)[0])
        gain = float(np.sum((J @ step) ** 2))
        if gain < NO_GAIN:
            break
        for halving in range(MOST_HALVINGS):
            there = np.clip(theta + 0.5**halving * step, low, high)
            found = rows_at(there)
            if found @ found < rows @ rows:
                break
        else:
            break
        theta, rows = there, found
    return theta


def null_space(rows: Array) -> Array:
    """Return an orthonormal basis of the null space of independent rows."""
    return np.linalg.svd(rows, full_matrices=True)[2][len(rows) :].T if len(rows) else np.eye(rows.shape[1])


def variance(J: Array, e: Array, correlation: float, known: bool) -> Array:
    """Return the covariance (k, k) of estimated coefficients from the slopes J and the whitened residuals e.

    The residuals are smaller than the noise, because the estimate is fitted to it: those of a sample by (1 - h)^1/2,
    where h is the leverage of the sample (Bell and McCaffrey 2002). This correction is used for single samples; blocks
    are corrected by their number.

    Args:
        J: (samples, r, k) derivatives of the rows by the coefficients.
        e: (samples, r) whitened residuals.
        correlation: correlation of the residuals of successive samples.
        known: whether the noise is known, so that it has unit variance; else size and correlation of e are used.
    """
    samples, r, k = J.shape
    inverse = np.linalg.inv(np.einsum("srj,srk->jk", J, J))
    if known:
        return inverse
    length = int(np.ceil(3.0 * (1.0 + correlation) / max(1.0 - correlation, 3.0 / samples))) if correlation else 1
    length = min(length, max(samples // (4 * k), 1))
    sizes, axes = np.linalg.eigh(np.eye(r) - np.einsum("srj,jk,stk->srt", J, inverse, J))
    part = np.einsum("srt,st,sut,su->sr", axes, np.maximum(sizes, LEAST_LEFT) ** -0.5, axes, e)
    blocks = np.add.reduceat(np.einsum("srj,sr->sj", J, part), np.arange(0, samples, length))
    few = 1.0 if length == 1 else len(blocks) / max(len(blocks) - k / r, 1.0)
    return few * inverse @ (blocks.T @ blocks) @ inverse
