"""How noisy the channels are, from what is left of the rows."""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

from holdfast.model import checks
from holdfast.spatial.scalar import Array

LEAST = 1e-6  # of a channel's size: noise below this is not believed
UNEVEN = 0.2  # of the usual noise relative to the channels' sizes: no channel gets more weight than that


def channel_sizes(measured: Array, kinds: Array) -> Array:
    """Return the root mean square of each kind of channel, (channels,); no kind is smaller than a thousandth of all.

    Args:
        measured: (samples, channels).
        kinds: (channels,) which channels share their noise.
    """
    found = np.array([np.sqrt(np.mean(measured[:, kinds == kind] ** 2)) for kind in kinds])
    return np.maximum(found, 1e-3 * found.max()) if found.max() > 0.0 else np.ones(len(kinds))


def estimated(maps: Array, residuals: Array, kinds: Array, sizes: Array) -> Array:
    """Return the channels' standard deviations, (channels,), one a kind.

    Of rows r = -P noise the products r r^T are, on average, sum var p p^T over the columns p of P. The variances >= 0
    whose sum is nearest to the products are found by least squares (Rao 1971); repeated with rows whitened by what
    was found before, that is the most likely of normal noise.

    Args:
        maps: (samples, r, channels) P, whitened.
        residuals: (samples, r), whitened.
        kinds: (channels,).
        sizes: (channels,) of what is measured.
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
    """Return (samples, r, r) what makes rows independent, of unit noise.

    Args:
        maps: (samples, r, channels).
        deviations: (channels,).
    """
    spread = maps * deviations
    V = np.einsum("src,stc->srt", spread, spread)
    sizes = np.einsum("srr->s", V)[:, None, None]
    V += 1e-12 * np.where(sizes > 0.0, sizes, 1.0) * np.eye(V.shape[1])  # freedoms without a channel
    return np.linalg.inv(np.linalg.cholesky(V))
