"""The estimate: what the rows can tell by weighted least squares, among possible bodies; the rest stays the model's.

Whitened rows are taken together to a triangle (QR). In units of what counts as one of each unknown, the triangle's
singular values are one over standard deviations of combinations: those below a limit are told. The others are held,

    min |R features(x)|^2    with    Q^T (xi - xi_model) / sizes = 0

over log-Cholesky numbers, so that every iterate is a possible body. With Z a basis of the changes that are held to,

    cov = Z G^-1 (sum_blocks u u^T) G^-1 Z^T,    u = Z^T sum J^T e,   G = Z^T J^T J Z

which is right whatever the noise's distribution, also where weights are not (White 1980); with given noise cov = Z
G^-1 Z^T. Blocks are as long as what is left stays correlated from sample to sample.
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

HARDLY = 0.01  # of what is measured: the noise that is taken first
ROUNDS = 3  # of weights and estimate
FIRM = 1e3  # of the largest singular value: how firmly what cannot be told is held
NARROWEST = 5.0  # e-folds of the spread of mass that an estimate may be off from the model
MOST_STEPS, MOST_HALVINGS = 100, 30
NO_GAIN = 1e-8  # of a sum of squares whose terms are 1 on average
BOUNDED = 1e-2  # of it, that the rows would gain by what no body has
CORRELATED = 0.1  # from one sample to the next: from here on samples are taken in blocks
LEAST_LEFT = 0.05  # of a residual, where a sample decides a coefficient alone


@dataclass(frozen=True, eq=False)
class Estimate:
    """An estimate and how sure it is.

    Attributes:
        plain: (p,) xi.
        covariance: (p, p) of it; 0 along what was held.
        held: (p, d) an orthonormal basis of the combinations, each in units of its size, that keep the model's values.
        residuals: (samples, r) rows at the estimate.
        noise: (channels,) standard deviations that the weights are of.
        misfit: mean square of the whitened residuals: 1 where the noise is what it should be.
        correlation: of a sample's whitened residuals with those of the next; 0 where it may be chance.
        possible: whether some body has what the rows alone ask for.
    """

    plain: Array
    covariance: Array
    held: Array
    residuals: Array
    noise: Array
    misfit: float
    correlation: float
    possible: bool


def estimate(system: Equations, look: Unknowns, kinds: Array, given: Array | None, largest: float) -> Estimate:
    """Return the estimate.

    Args:
        system: the rows.
        look: the unknowns.
        kinds: (channels,) which channels share their noise.
        given: (channels,) standard deviations; None: they are estimated.
        largest: standard deviation of a combination, in units of its size, above which it is not told.
    """
    for x in (system.rows, system.measured, system.maps):
        checks.finite(x, "identify: recordings")
    sizes = channel_sizes(system.measured, kinds)
    noise, theta = HARDLY * sizes if given is None else given, look.start
    held, rows = np.zeros((0, 0)), system.rows
    for _ in range(ROUNDS if given is None else 1):
        W = whitener(system.maps, noise)
        rows = W @ system.rows
        _, R = np.linalg.qr(rows.reshape(-1, rows.shape[2]))
        held, told = combinations(R @ look.features(look.linear(theta))[1] * look.linear_sizes, largest)
        theta = solved(R, look, held, told)
        values = look.features(look.linear(theta))[0]
        if given is None:
            noise = estimated(W @ system.maps, rows @ values, kinds, sizes)
    if held.shape[0] == held.shape[1]:
        raise StateError(
            "identify: expected a recording that tells something of the payload, got one in which all that shows is"
            " below the noise; try larger and faster motions, turns above all"
        )
    values, slopes = look.features(look.linear(theta))
    e, J = rows @ values, rows @ slopes * look.linear_sizes
    correlation = float((e[1:] * e[:-1]).sum() / max((e * e).sum(), 1e-300))
    if correlation < max(CORRELATED, 3.0 / np.sqrt(e.size)):  # as of independent samples
        correlation = 0.0
    to_x, to_plain = look.slopes(theta)
    change = (to_plain @ np.linalg.inv(to_x)) * look.linear_sizes / look.sizes[:, None]
    Z = null_space(held.T @ change)
    pull = np.einsum("srj,sr->j", J @ Z, e)  # zero at a minimum that possible bodies do not bound
    gain = float(pull @ np.linalg.solve(np.einsum("srj,srk->jk", J @ Z, J @ Z), pull))
    spread = change @ Z @ variance(J @ Z, e, correlation, given is not None) @ Z.T @ change.T
    covariance = spread * np.outer(look.sizes, look.sizes)
    freedoms = max(e.size - Z.shape[1], 1)
    misfit = float((e * e).sum()) / freedoms
    left = system.rows @ values
    checks.finite(np.append(covariance, left), "identify: the estimate")
    return Estimate(look.plain(theta), covariance, held, left, noise, misfit, correlation, gain < BOUNDED)


def combinations(J: Array, largest: float) -> tuple[Array, Array]:
    """Return bases of what cannot be told, (p, d), and of what can, (p, k)."""
    checks.finite(J, "identify: what the recordings tell")
    _, singular, Vt = np.linalg.svd(J, full_matrices=True)
    count = int((singular * largest >= 1.0).sum())
    return Vt[count:].T, Vt[:count].T


def solved(R: Array, look: Unknowns, held: Array, told: Array) -> Array:
    """Return theta of the best possible body.

    Args:
        R: (.., features) triangle of the whitened rows.
        look: the unknowns.
        held: basis of the combinations that keep the model's values.
        told: basis of the others.
    """
    firm = FIRM * float(np.linalg.norm(R[:, :10] * look.linear_sizes[:10], ord=2)) or 1.0

    def rows_at(theta: Array) -> Array:
        off = (look.plain(theta) - look.model) / look.sizes
        return np.concatenate([R @ look.features(look.linear(theta))[0], firm * (held.T @ off)])

    def slopes_at(theta: Array) -> Array:
        to_x, to_plain = look.slopes(theta)
        of_rows = R @ look.features(look.linear(theta))[1] @ to_x
        return np.vstack([of_rows, firm * held.T @ (to_plain / look.sizes[:, None])])

    start = look.start
    values, slopes = look.features(look.linear(start))
    J = R @ slopes * look.linear_sizes
    step = -told @ (np.linalg.pinv(J @ told) @ (R @ values))
    x = look.linear(start) + step * look.linear_sizes
    begin = start
    with contextlib.suppress(ValueError):  # a step to what no body has
        begin = np.concatenate([numbers_of(of_parameters(x[:10])), x[10:]])
    width = np.full(len(start), np.inf)
    width[1:4] = NARROWEST
    return gauss_newton(rows_at, slopes_at, begin, start - width, start + width)


def gauss_newton(
    rows_at: Callable[[Array], Array], slopes_at: Callable[[Array], Array], theta: Array, low: Array, high: Array
) -> Array:
    """Return where whitened rows are least, within bounds; rows are nearly linear, so that few steps are needed."""
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
    """Return an orthonormal basis of what independent rows take to zero."""
    return np.linalg.svd(rows, full_matrices=True)[2][len(rows) :].T if len(rows) else np.eye(rows.shape[1])


def variance(J: Array, e: Array, correlation: float, known: bool) -> Array:
    """Return (k, k) the covariance of coefficients whose slopes J, (samples, r, k), whitened residuals e leave.

    Residuals are smaller than the noise, as the estimate follows it: a sample's by (1 - h)^1/2, h its part of the
    projection on the slopes (Bell and McCaffrey 2002). Only whole samples are corrected so; blocks by their number.

    Args:
        J: (samples, r, k).
        e: (samples, r).
        correlation: of a sample's residuals with the next.
        known: whether residuals are of unit noise; else their own size and correlation count.
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
