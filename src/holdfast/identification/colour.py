"""Whether residuals are independent from sample to sample, and how much wider the deviations are if not.

Sums over blocks of L samples have L times the variance of single samples if these are independent. The largest ratio

    widening = max over L of  mean (sum over a block)^2 / (L mean e^2)

is the number of samples that tell as much as one independent sample. It multiplies the covariance, which is an upper
bound, reached by motions that are slow compared with the noise's memory. Where recordings are too short for long
blocks, the ratio is at least that of noise whose correlation falls geometrically, (1 + rho) / (1 - rho), with rho
corrected for the bias of short samples (Kendall 1954).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from holdfast.spatial.scalar import Array

FEWEST_BLOCKS = 8
EXACT = 1e-3  # mean square of rows that are exact, relative to the noise
CHANCE = 1e-6  # that independent residuals exceed a limit


@dataclass(frozen=True)
class Colour:
    """How residuals depend on those before them.

    Attributes:
        correlation: correlation of residuals of successive samples.
        widening: factor of the covariance, >= 1.
        coloured: whether they depend on each other, beyond chance.
    """

    correlation: float
    widening: float
    coloured: bool


def colour_of(e: Array, memory: int) -> Colour:
    """Return how whitened residuals e, (samples, r), depend on those before them.

    Args:
        e: the residuals.
        memory: samples over which the errors of smoothed motions depend on each other, which is accounted for
            elsewhere.
    """
    e = e[:, (e * e).mean(axis=0) > EXACT]
    squares = (e * e).mean(axis=0)
    correlation = float((e[1:] * e[:-1]).sum() / max(float((e * e).sum()), 1e-300))
    widening, coloured = 1.0, False
    length = 2
    while e.size and len(e) // length >= FEWEST_BLOCKS:
        if length >= memory:
            blocks = e[: len(e) // length * length].reshape(-1, length, e.shape[1]).sum(axis=1)
            ratios = (blocks * blocks).mean(axis=0) / np.maximum(length * squares, 1e-300)
            count = len(blocks)
            for ratio, freedoms in [
                *((x, count) for x in ratios.tolist()),
                (float(ratios.mean()), count * len(ratios)),
            ]:
                low, high = chi2.ppf([CHANCE, 1.0 - CHANCE], freedoms) / freedoms
                if ratio > high:
                    widening = max(widening, ratio)
                coloured = coloured or not low < ratio < high
        length *= 2
    if widening > 1.0:
        lasting = min(correlation + (1.0 + 4.0 * correlation) / len(e), 1.0 - 2.0 / len(e))
        widening = max(widening, (1.0 + lasting) / (1.0 - lasting))
    return Colour(correlation, widening, coloured)
