"""The unconstrained weighted estimate, with weights from its own residuals.

The weights are the inverse covariance of the rows, from the noise of the measurements and of the motion. The former is
found from the residuals (`noise.estimated`), the residuals from the estimate, the estimate with the weights, and this is
repeated until the noise no longer changes. The guess takes no part in it: neither is anything kept, nor is the body required
to be possible.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.identification.equations import Equations
from holdfast.identification.motion_noise import JointNoise
from holdfast.identification.noise import channel_sizes, estimated, least_noise, whitener
from holdfast.identification.unknowns import Unknowns
from holdfast.spatial.scalar import Array

HARDLY = 0.01  # initial guess of the noise, relative to the measurements
MOST_ROUNDS = 60  # alternations of weights and estimate
DAMPED = 20  # rounds after which the noise changes by half as much only
SETTLED = 1e-4  # relative change of the noise at which they end
UNTOLD = 1e-11  # singular values below this, relative to the largest one, are rounding
MOST_STEPS, NO_STEP = 30, 1e-12  # Gauss-Newton, which needs two steps unless gravity is sought


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
        settled: whether the noise no longer changed.
    """

    x: Array
    rows: Array
    weights: Array
    triangle: Array
    noise: Array
    of_motion: Array | None
    settled: bool


def free_fit(
    system: Equations, unknowns: Unknowns, kinds: Array, given: Array | None, motion: list[JointNoise]
) -> FreeFit:
    """Return the unconstrained estimate; see `estimate`."""
    sizes = channel_sizes(system.measured, kinds)
    least = least_noise(system.measured, sizes)
    noise = np.maximum(HARDLY * sizes, least) if given is None else given
    x, known = unknowns.model, None
    samples, r, _ = system.rows.shape
    few = 1.0 / np.sqrt(max(1.0 - len(x) / (samples * r), 0.1))  # residuals are smaller than noise
    settled = False
    for round in range(MOST_ROUNDS):
        W = whitener(system.maps, noise, known)
        rows = W @ system.rows
        _, R = np.linalg.qr(rows.reshape(-1, rows.shape[2]))
        x = least_squares(R, unknowns, x)
        values = unknowns.features(x)[0]
        seen = None if known is None else W @ known @ W.transpose(0, 2, 1)
        before, noise = noise, noise
        if given is None:
            found = np.maximum(few * estimated(W @ system.maps, rows @ values, kinds, sizes, seen), least)
            noise = found if round < DAMPED else np.sqrt(found * before)
        settled = float(np.abs(noise / before - 1.0).max()) < SETTLED and (known is not None or not motion)
        if settled:
            break
        if motion:
            known = np.zeros((samples, r, r))
            for one in motion:
                known[one.samples] += one.spread(system.maps, values)
    return FreeFit(x, rows, W, R, noise, seen, settled)


def least_squares(R: Array, unknowns: Unknowns, x: Array) -> Array:
    """Return the unknowns with the least sum of squares |R features(x)|^2 that are nearest to given ones."""
    sizes = unknowns.linear_sizes
    for _ in range(MOST_STEPS):
        values, slopes = unknowns.features(x)
        step = np.linalg.lstsq(R @ slopes * sizes, -(R @ values), rcond=UNTOLD)[0]
        x = x + step * sizes
        if float(np.abs(step).max()) < NO_STEP or (not unknowns.tilted and _ > 1):
            break
    return x
