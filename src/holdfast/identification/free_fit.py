"""The unconstrained weighted estimate, with weights from its own residuals.

The weights are the inverse covariance of the rows, from the noise of the measurements and of the motion. The former is
found from the residuals (`estimated`), the residuals from the estimate, the estimate with the weights, and this
is repeated until the noise no longer changes. The guess takes no part in it: nothing is kept, and the body need not be
possible. Where positions are smoothed, samples whose residuals are beyond chance are left out: there the joints
accelerate within less than samples show, such as when a controller is switched on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls
from scipy.special import chdtri

from holdfast.identification.equations import Equations
from holdfast.identification.motion_noise import JointNoise
from holdfast.identification.payload_unknowns import PayloadUnknowns
from holdfast.identification.smoothing import encoder_step
from holdfast.model import checks
from holdfast.spatial.scalar import Array

HARDLY = 0.01  # initial guess of the noise, relative to the measurements
MOST_REWEIGHTINGS = 60  # alternations of weights and estimate
DAMPED = 20  # rounds after which the noise changes by half as much only
SETTLED = 1e-4  # relative change of the noise at which they end
LEAST_SINGULAR_VALUE = 1e-11  # singular values below this, relative to the largest one, are rounding
GAUSS_NEWTON_STEPS, LINEAR_STEPS = 30, 2  # if gravity is unknown; if it is known
LEAST_STEP = 1e-12  # at which they end
FEWEST_DIFFERENCED = 20  # samples by whose differences noise is found
LEAST_NOISE = 1e-6  # lower bound of the noise, relative to a channel's size
BEYOND_CHANCE = 1e-6  # chance of residuals like those of a sample that is left out
MOST_FAR = 0.05  # share of such samples above which the model is wrong instead, so that none is left out
UNEVEN = 0.2  # lower bound of a channel's relative noise, as a fraction of the typical one; limits its weight


@dataclass(frozen=True, eq=False)
class FreeFit:
    """An unconstrained estimate.

    Attributes:
        x: (p,) the estimate; combinations on which nothing depends have the model's values.
        rows: (samples, r, features) the whitened rows.
        weights: (samples, r, r) the matrices that whiten the rows.
        triangle: R of their QR decomposition.
        noise: (channels,) standard deviations of the measurements.
        of_motion: (samples, r, r) share of the noise of the motion in the whitened rows; None if the motion is exact.
        far: (samples,) which are left out, so that their rows and weights are 0.
        settled: whether the noise no longer changed.
    """

    x: Array
    rows: Array
    weights: Array
    triangle: Array
    noise: Array
    of_motion: Array | None
    far: Array
    settled: bool = False

    @property
    def motion_share(self) -> float:
        """The part of the variance of the whitened residuals that is due to the noise of the motion."""
        if self.of_motion is None:
            return 0.0
        return float(np.einsum("srr->", self.of_motion)) / self.rows[..., 0].size


def free_fit(
    system: Equations, unknowns: PayloadUnknowns, kinds: Array, given: Array | None, motion: Sequence[JointNoise]
) -> FreeFit:
    """Return the unconstrained estimate; see `estimate`."""
    whole = _settled(system, unknowns, kinds, given, motion, np.zeros(len(system.rows), bool))
    far = far_off(whole.rows @ unknowns.features(whole.x)[0]) if motion else whole.far
    return _settled(system, unknowns, kinds, given, motion, far) if far.any() else whole


def far_off(e: Array) -> Array:
    """Return which samples have whitened residuals e, (samples, r), beyond chance; none if these are many."""
    squares, r = (e * e).sum(axis=1), e.shape[1]
    far = squares > chdtri(r, BEYOND_CHANCE) * max(float(np.median(squares) / chdtri(r, 0.5)), 1.0)
    return far & (far.mean() <= MOST_FAR)


def _settled(
    system: Equations,
    unknowns: PayloadUnknowns,
    kinds: Array,
    given: Array | None,
    motion: Sequence[JointNoise],
    far: Array,
) -> FreeFit:
    """Return the estimate without some samples, with weights and noise that agree with it."""
    sizes = channel_sizes(system.measured, kinds)
    least = least_noise(system.measured, sizes)
    few = 1.0 / np.sqrt(max(1.0 - len(unknowns.names) / system.rows[..., 0].size, 0.1))  # residuals are below the noise
    fit = _weighted(
        system, unknowns, unknowns.model, np.maximum(HARDLY * sizes, least) if given is None else given, [], far
    )
    if motion:
        least = np.maximum(least, white_noise(system.measured, kinds, motion))
    for count in range(MOST_REWEIGHTINGS):
        noise = fit.noise
        if given is None:
            residuals = fit.rows @ unknowns.features(fit.x)[0]
            found = estimated(fit.weights @ system.maps, residuals, kinds, sizes, fit.of_motion)
            noise = np.maximum(few * found, least)
            noise = noise if count < DAMPED else np.sqrt(noise * fit.noise)
        if float(np.abs(noise / fit.noise - 1.0).max()) < SETTLED and (count or not motion):
            return replace(fit, settled=True)
        fit = _weighted(system, unknowns, fit.x, noise, motion, far)
    return fit


def white_noise(measured: Array, kinds: Array, motion: Sequence[JointNoise]) -> Array:
    """Return the white noise of the channels, (channels,), from their own differences, if positions are noisy.

    In single samples, the errors of smoothed accelerations hide it; in sums over many samples, it is often the larger.
    """
    parts = {one.samples.start: one.samples for one in motion}.values()
    found = np.sum([noise_of_columns(measured[samples]) ** 2 for samples in parts], axis=0) / len(parts)
    return np.sqrt([found[kinds == kind].mean() for kind in kinds])


def _weighted(
    system: Equations, unknowns: PayloadUnknowns, x: Array, noise: Array, motion: Sequence[JointNoise], far: Array
) -> FreeFit:
    """Return the estimate with weights for given noise, and for that of the motion, at the previous estimate x."""
    known = None
    if motion:
        known = np.zeros((*system.rows.shape[:2], system.rows.shape[1]))
        for one in motion:
            known[one.samples] += one.spread(system.motions, unknowns.features(x)[0])
    W = whitener(system.maps, noise, known) * ~far[:, None, None]
    rows = W @ system.rows
    _, R = np.linalg.qr(rows.reshape(-1, rows.shape[2]))
    share = None if known is None else W @ known @ W.transpose(0, 2, 1)
    return FreeFit(least_squares(R, unknowns, x), rows, W, R, noise, share, far)


def least_squares(R: Array, unknowns: PayloadUnknowns, x: Array) -> Array:
    """Return the unknowns with the least sum of squares |R features(x)|^2 that are nearest to given ones."""
    sizes = unknowns.linear_sizes
    for _ in range(GAUSS_NEWTON_STEPS if unknowns.tilted else LINEAR_STEPS):
        values, slopes = unknowns.features(x)
        step = np.linalg.lstsq(R @ slopes * sizes, -(R @ values), rcond=LEAST_SINGULAR_VALUE)[0]
        x = x + step * sizes
        if float(np.abs(step).max()) < LEAST_STEP:
            break
    return x


def channel_sizes(measured: Array, kinds: Array) -> Array:
    """Return the root mean square of each kind of channel, (channels,), at least a thousandth of the largest one.

    Args:
        measured: (samples, channels) measurements.
        kinds: (channels,) labels; channels with the same label have the same noise.
    """
    found = np.array([np.sqrt(np.mean(measured[:, kinds == kind] ** 2)) for kind in kinds])
    return np.maximum(found, 1e-3 * found.max()) if found.max() > 0.0 else np.ones(len(kinds))


def least_noise(measured: Array, sizes: Array) -> Array:
    """Return the least standard deviations, (channels,), that float64 or a sensor's steps leave."""
    steps = np.array([encoder_step(column) for column in measured.T])
    return np.maximum(LEAST_NOISE * sizes, steps / np.sqrt(12.0))


def noise_of_columns(x: Array) -> Array:
    """Return the white noise in columns (samples, k) that are smooth otherwise, (k,), by their sixth differences."""
    if len(x) < FEWEST_DIFFERENCED:
        return np.zeros(x.shape[1])
    rough = np.median(np.abs(np.diff(x, n=6, axis=0)), axis=0)
    return rough / (0.6745 * np.sqrt(924.0))  # the median of normal noise; the sum of the squared weights


def estimated(maps: Array, residuals: Array, kinds: Array, sizes: Array, known: Array | None) -> Array:
    """Return the estimated standard deviations of the channels, (channels,), which are equal within a kind.

    For residuals r = -P noise, the mean of r r^T is the sum of var p p^T over the columns p of P. Variances >= 0 are
    fitted to r r^T by least squares (Rao 1971). Repeated with rows that are whitened by the previous result, this
    converges to the maximum-likelihood estimate for normal noise.

    Args:
        maps: (samples, r, channels) P, whitened.
        residuals: (samples, r) whitened residuals.
        kinds: (channels,) labels of the channels.
        sizes: (channels,) sizes of the measurements.
        known: (samples, r, r) covariance of that part of the residuals which has other reasons, whitened; None for
            none.
    """
    members = (kinds[:, None] == np.unique(kinds)).astype(float)
    scaled = maps * sizes
    grams = np.einsum("src,srd->scd", scaled, scaled)
    normal = members.T @ (grams**2).sum(axis=0) @ members
    products = (np.einsum("src,sr->sc", scaled, residuals) ** 2).sum(axis=0)
    if known is not None:
        products = products - np.einsum("src,srt,stc->c", scaled, known, scaled)
    checks.finite(np.append(normal, products), "identify: residuals")
    relative = np.sqrt(nnls(normal, products @ members)[0])
    usual = float(np.median(relative[relative > 0.0])) if (relative > 0.0).any() else 0.0
    return sizes * (members @ np.maximum(relative, UNEVEN * usual))


def whitener(maps: Array, deviations: Array, known: Array | None) -> Array:
    """Return matrices (samples, r, r) that whiten the rows: their noise becomes independent with unit variance.

    Args:
        maps: (samples, r, channels) from the noise of the channels to the rows.
        deviations: (channels,) standard deviations of the noise.
        known: (samples, r, r) covariance of the rows for other reasons; None for none.
    """
    spread = maps * deviations
    V = np.einsum("src,stc->srt", spread, spread)
    if known is not None:
        V = V + known
    sizes = np.einsum("srr->s", V)[:, None, None]
    V += 1e-12 * np.where(sizes > 0.0, sizes, 1.0) * np.eye(V.shape[1])  # freedoms without a channel
    return np.linalg.inv(np.linalg.cholesky(V))
