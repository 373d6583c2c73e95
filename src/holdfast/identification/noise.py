"""Estimating the noise of the measured channels from the residuals."""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

from holdfast.model import checks
from holdfast.spatial.scalar import Array

LEAST = 1e-6  # lower bound of the noise, relative to a channel's size
UNEVEN = 0.2  # lower bound of a channel's relative noise, as a fraction of the typical one; limits its weight


def channel_sizes(measured: Array, kinds: Array) -> Array:
    """Return the root mean square of each kind of channel, (channels,), at least a thousandth of the largest one.

    Args:
        measured: (samples, channels) measurements.
        kinds: (channels,) labels; channels with the same label have the same noise.
    """
    found = np.array([np.sqrt(np.mean(measured[:, kinds == kind] ** 2)) for kind in kinds])
    return np.maximum(found, 1e-3 * found.max()) if found.max() > 0.0 else np.ones(len(kinds))


def estimated(maps: Array, residuals: Array, kinds: Array, sizes: Array) -> Array:
    """Return the estimated standard deviations of the channels, (channels,), which are equal within a kind.

    For residuals r = -P noise, the mean of r r^T is the sum of var p p^T over the columns p of P. Variances >= 0 are
    fitted to r r^T by least squares (Rao 1971). Repeated with rows that are whitened by the previous result, this
    converges to the maximum-likelihood estimate for normal noise.

    Args:
        maps: (samples, r, channels) P, whitened.
        residuals: (samples, r) whitened residuals.
        kinds: (channels,) labels of the channels.
        sizes: (channels,) sizes of the measurements.
    """
    members = (kinds[:, None] == np.unique(kinds)).astype(float)
    scaled = maps * sizes
    grams = np.einsum("src,srd->scd", scaled, scaled)
    normal = members.T @ (grams**2).sum(axis=0) @ members
    products = np.einsum("src,sr->sc", scaled, residuals)
    checks.finite(np.append(normal, products**2), "identify: residuals")
    relative = np.sqrt(nnls(normal, (products**2).sum(axis=0) @ members)[0])
    usual = float(np.median(relative[relative > 0.0])) if (relative > 0.0).any() else 0.0
    return sizes * (members @ np.maximum(relative, max(UNEVEN * usual, LEAST)))


def whitener(maps: Array, deviations: Array) -> Array:
    """Return matrices (samples, r, r) that whiten the rows: their noise becomes independent with unit variance.

    Args:
        maps: (samples, r, channels) from the noise of the channels to the rows.
        deviations: (channels,) standard deviations of the noise.
    """
    spread = maps * deviations
    V = np.einsum("src,stc->srt", spread, spread)
    sizes = np.einsum("srr->s", V)[:, None, None]
    V += 1e-12 * np.where(sizes > 0.0, sizes, 1.0) * np.eye(V.shape[1])  # freedoms without a channel
    return np.linalg.inv(np.linalg.cholesky(V))
