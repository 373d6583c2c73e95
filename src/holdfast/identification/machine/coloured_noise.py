"""What noise that depends on its own past does to an estimate: autoregressive models of the residuals.

A weighted least-squares estimate has the error G^-1 sum B_k^T noise_k. Where the noise of a channel is an
autoregressive process, noise = C epsilon with independent epsilon and a causal filter C, the covariance of the sum is

    M = (C^T B)^T (C^T B) var(epsilon)

so that B, filtered backwards in time, takes the place of B. The order of the process is that with the least
information criterion of Akaike (1974), its coefficients are Burg's, whose filters are stable.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from holdfast.spatial.scalar import Array

LARGEST_ORDER = 30  # of the autoregressive process
SAMPLES_PER_ORDER = 12  # fewer samples than this per coefficient tell no order


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

    def filtered(self, B: Array) -> Array:
        """Return C^T B for noise of unit variance, (samples, k)."""
        return np.sqrt(self.gain) * lfilter([1.0], self.a, B[::-1], axis=0)[::-1]


def autoregression(parts: list[Array]) -> Autoregression:
    """Return the process that residuals follow, from series (samples,) without gaps. O(samples LARGEST_ORDER)."""
    count = sum(map(len, parts))
    total = sum(float(x @ x) for x in parts)
    if not total > 0.0:
        return Autoregression(np.ones(1), 1.0)
    forward, backward = [x.copy() for x in parts], [x.copy() for x in parts]
    a, variance = np.ones(1), total / count
    best, least = Autoregression(a, 1.0), count * np.log(variance)
    for order in range(1, min(LARGEST_ORDER, count // SAMPLES_PER_ORDER) + 1):
        pairs = [(f[1:], b[:-1]) for f, b in zip(forward, backward, strict=True) if len(f) > 1]
        power = sum(float(f @ f + b @ b) for f, b in pairs)
        if not power > 0.0:
            break
        k = -2.0 * sum(float(f @ b) for f, b in pairs) / power
        forward, backward = [f + k * b for f, b in pairs], [b + k * f for f, b in pairs]
        a = np.append(a, 0.0) + k * np.append(a, 0.0)[::-1]
        variance *= 1.0 - k * k
        if not variance > 0.0:
            break
        cost = count * np.log(variance) + 2.0 * order
        if cost < least:
            best, least = Autoregression(a, variance * count / total), cost
    return best
