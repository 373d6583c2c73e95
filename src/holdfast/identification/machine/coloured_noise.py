"""What noise that depends on its own past does to an estimate: autoregressive models of the residuals.

A weighted least-squares estimate has the error G^-1 sum B_k^T noise_k. Where the noise of a channel is an
autoregressive process, noise = C epsilon with independent epsilon and a causal filter C, the covariance of the sum is

    M = (C^T B)^T (C^T B) var(epsilon)

so that B, filtered backwards in time, takes the place of B.

Residuals show less slow noise than there is, because slow unknowns explain part of it. As in restricted maximum
likelihood (Harville 1977), the autocovariances are therefore those that are expected of the noise itself:

    R(l) = sum_k  r_k r_k+l  +  u_k H^-1 u_k+l^T

with residuals r of a fit that is weighted by the inverse of the process, its information H, and the derivatives u of
the residuals. Process and fit are found in turns. The coefficients are those of Yule and Walker, whose filters are
stable; the order is that with the least information criterion of Akaike (1974). All channels have one process, unless
the criterion of Schwarz (1978), which adds fewer parameters, says that they differ.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.fft import irfft, rfft
from numpy.typing import ArrayLike
from scipy.fft import next_fast_len

from holdfast.spatial.scalar import Array

LARGEST_ORDER = 30  # of the autoregressive process
SAMPLES_PER_ORDER = 12  # fewer samples than this per coefficient tell no order
MOST_FITS = 6  # of process and fit
FREQUENCIES = 4096  # around the circle, at which densities are evaluated
SAME_DENSITY = 0.01  # relative change of the density of slow noise that ends them


@dataclass(frozen=True, eq=False)
class Autoregression:
    """noise_k + a_1 noise_k-1 + ... = epsilon_k.

    Attributes:
        a: (order + 1,) coefficients, the first of which is 1.
        gain: variance of epsilon, relative to that of the noise.
    """

    a: Array
    gain: float

    @property
    def slow_noise(self) -> float:
        """The spectral density at frequency zero, in units of that of white noise with the same variance."""
        return self.gain / float(self.a.sum()) ** 2

    @property
    def repetition(self) -> float:
        """The number of samples that tell as much about the variance of the noise as one of white noise (Bartlett)."""
        density = 1.0 / np.abs(rfft(self.a, FREQUENCIES)) ** 2
        return float((density**2).mean() / density.mean() ** 2)

    def filtered(self, B: Array) -> Array:
        """Return C^T B for noise of unit variance, (samples, k)."""
        return np.sqrt(self.gain) * _filtered([1.0], self.a, B[::-1])[::-1]

    def whitened(self, B: Array) -> Array:
        """Return C^-1 B for noise of unit variance, (samples, k)."""
        return _filtered(self.a, [1.0], B) / np.sqrt(self.gain)


def _filtered(b: ArrayLike, a: ArrayLike, B: Array) -> Array:
    """Return columns filtered by b(z) / a(z), (samples, k)."""
    from scipy.signal import lfilter  # imported here because it takes a second

    found: Any = lfilter(b, a, B, axis=0)
    return found


WHITE = Autoregression(np.ones(1), 1.0)


def autoregressions(
    errors: Array, slopes: Array, shares: Array, known: Array, parts: list[slice]
) -> tuple[list[Autoregression], float]:
    """Return the process of every channel, and the variance of all noise in units of what it was taken for.

    The cost is O(samples channels p^2) for each round.

    Args:
        errors: (samples, channels) errors of the measurements in units of their noise; 0 where they do not count.
        slopes: (samples, channels, p) their derivatives by the unknowns.
        shares: (channels,) number of samples that a channel's errors stand for.
        known: (p,) inverse variances of the unknowns' prior.
        parts: the samples of each recording.
    """
    slopes = slopes / np.sqrt(known)
    found, size = _processes(errors[:, :, None], shares, parts)
    for _ in range(MOST_FITS):
        if all(len(one.a) == 1 for one in found):
            break
        whole = np.concatenate([slopes, errors[:, :, None]], axis=2)
        filtered = [one.whitened(whole[part, c]) for c, one in enumerate(found) for part in parts]
        gram = np.sum([one.T @ one for one in filtered], axis=0)
        sizes, axes = np.linalg.eigh(gram[:-1, :-1])
        unseen = slopes @ (axes / np.sqrt(np.maximum(sizes, 0.0) + 1.0))
        left = errors - unseen @ ((axes.T @ gram[:-1, -1]) / np.sqrt(np.maximum(sizes, 0.0) + 1.0))
        before = found
        found, size = _processes(np.concatenate([left[:, :, None], unseen], axis=2), shares, parts)
        changes = [abs(a.slow_noise / b.slow_noise - 1.0) for a, b in zip(found, before, strict=True)]
        if max(changes) < SAME_DENSITY:
            break
    return found, size


def _processes(series: Array, shares: Array, parts: list[slice]) -> tuple[list[Autoregression], float]:
    """Return the processes and size of series (samples, channels, k), whose autocovariances are summed over k."""
    highest = int(
        min(LARGEST_ORDER, shares.max() // SAMPLES_PER_ORDER, *(part.stop - part.start - 1 for part in parts))
    )
    R = np.sum([autocovariance(series[part], highest) for part in parts], axis=0)
    total = np.where(R[0] > 0.0, R[0], 1.0)
    own = [_least(R[:, c] / total[c], float(shares[c])) for c in range(R.shape[1])]
    common, cost = _least((R / total) @ shares / shares.sum(), float(shares.sum()))
    orders, one_order = [len(one.a) - 1 for one, _ in own], len(common.a) - 1
    a_parameter = np.log(max(float(shares.sum()), 2.0)) - 2.0  # what Schwarz's criterion adds to Akaike's
    apart = sum(each for _, each in own) + a_parameter * sum(orders)
    differ = apart < cost + a_parameter * one_order
    return [one for one, _ in own] if differ else [common] * len(own), float(R[0].sum() / shares.sum())


def autocovariance(x: Array, highest: int) -> Array:
    """Return sums of x_k x_k+l over samples and series, (highest + 1, channels), of (samples, channels, series)."""
    n = next_fast_len(len(x) + highest, real=True)
    return np.array([
        irfft((np.abs(rfft(x[:, c], n, axis=0)) ** 2).sum(axis=1), n)[: highest + 1] for c in range(x.shape[1])
    ]).T  # fmt: skip


def _least(R: Array, count: float) -> tuple[Autoregression, float]:
    """Return the process with autocovariances R, R[0] = 1 or 0, that has the least criterion, and the criterion."""
    a, variance = np.ones(1), 1.0
    best, least = WHITE, 0.0
    for order in range(1, len(R) if R[0] > 0.0 else 0):
        k = -float(a @ R[order:0:-1]) / variance  # Levinson's recursion
        a = np.append(a, 0.0) + k * np.append(a, 0.0)[::-1]
        variance *= 1.0 - k * k
        if not variance > 0.0:
            break
        cost = count * np.log(variance) + 2.0 * order
        if cost < least:
            best, least = Autoregression(a, variance), cost
    return best, least
