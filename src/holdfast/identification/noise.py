"""Estimating the noise of the measured channels from the residuals."""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

from holdfast.identification.smoothing import encoder_step
from holdfast.model import checks
from holdfast.spatial.scalar import Array

FEWEST_DIFFERENCED = 20  # samples by whose differences noise is found
LEAST_NOISE = 1e-6  # lower bound of the noise, relative to a channel's size
UNEVEN = 0.2  # lower bound of a channel's relative noise, as a fraction of the typical one; limits its weight


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
