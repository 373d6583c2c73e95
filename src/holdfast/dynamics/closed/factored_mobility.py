"""A mobility that is never summed up: P = sum_j D_j w_j w_j^T, and its update by one measurement.

Bierman's update (G. J. Bierman, Factorization Methods for Discrete Sequential Estimation,
1977, ch. V) only multiplies and divides D. Mobilities of a light object and of heavy arms stay
apart to the last digit, which neither P -= k k^T / sigma nor the Joseph form achieve.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.spatial.linalg import largest_first
from holdfast.spatial.scalar import Array, Scalar, array, where

ROUNDING = 1e-14  # a pivot below this part of its size is zero
NOTHING = 1e-32  # of sigma: what such a column adds to it is less than the rounding of its rounding


class FactoredMobility(NamedTuple):
    """P = sum_j D_j w_j w_j^T.

    Attributes:
        D: six factors >= 0.
        w: six columns, (6,) each.
    """

    D: list[Scalar]
    w: list[Array]

    def apply(self, wrench: Array) -> Array:
        """Return P f: the acceleration that a wrench at G brings."""
        return sum((D * (w @ wrench) * w for D, w in zip(self.D, self.w, strict=True)), start=np.zeros(6))

    def dense(self) -> Array:
        """Return P, (6, 6)."""
        W = array(self.w).T
        return (W * array(self.D)) @ W.T


def factored(P: Array, size: Array) -> FactoredMobility:
    """Return the factors of a mobility given as a (6, 6) matrix, without its rounding.

    Args:
        P: (6, 6) positive semidefinite.
        size: (6,) size of what each diagonal entry was summed from.
    """
    return FactoredMobility(*largest_first(P, size, ROUNDING))


def updated(P: FactoredMobility, c: Array, d: Scalar, least: Scalar) -> tuple[FactoredMobility, Array, Scalar, Scalar]:
    """Return P after one row c, k = P c^T, sigma = c P c^T + d, and whether sigma > least.

    Bierman's update: with alpha_0 = d, alpha_j = alpha_{j-1} + D_j f_j^2, f_j = c w_j:
    D_j *= alpha_{j-1} / alpha_j,  w_j -= (f_j / alpha_{j-1}) sum_{i<j} D_i f_i w_i.
    A row that repeats earlier ones (sigma <= least) leaves P as it is. So do columns that it hardly sees, f_j the
    rounding of zero: alpha would be so small that f_j / alpha overflows.
    """
    f = [c @ w for w in P.w]
    summands = [D * fj * fj for D, fj in zip(P.D, f, strict=True)]
    sigma = sum(summands, start=d)
    alive = sigma > least
    seen = where(alive, NOTHING * sigma, float("inf"))
    alpha, k = d, np.zeros(6)
    D_new, w_new = [], []
    for D, w, fj, summand in zip(P.D, P.w, f, summands, strict=True):
        fj = where(summand > seen, fj, 0.0)
        v = D * fj
        above = alpha + v * fj
        some = alpha > 0.0
        w_new.append(w - where(some, fj / where(some, alpha, 1.0), 0.0) * k)  # alpha = 0: k = 0
        any_yet = above > 0.0
        D_new.append(where(any_yet, D * (alpha / where(any_yet, above, 1.0)), D))
        k = k + v * w
        alpha = above
    return FactoredMobility(D_new, w_new), k, sigma, alive
