"""A mobility in factored form, P = sum_j D_j w_j w_j^T, and its update by one measurement.

Bierman's update (G. J. Bierman, Factorization Methods for Discrete Sequential Estimation, 1977, ch. V) only multiplies
and divides the factors D. The mobilities of a light object and of heavy arms therefore both keep all their digits,
which neither P -= k k^T / sigma nor the Joseph form achieves.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.spatial.linalg import largest_first
from holdfast.spatial.scalar import Array, Scalar, array, where

ZERO_PIVOT = 1e-14  # pivots smaller than this, relative to their size, are zero
NEGLIGIBLE_PART = 1e-32  # contributions of columns to sigma that are smaller than this part of it are ignored


class FactoredMobility(NamedTuple):
    """A mobility P = sum_j D_j w_j w_j^T.

    Attributes:
        D: factors >= 0; six, and one more for each trunk joint that has been included.
        w: columns, (6,) each, as many as factors.
    """

    D: list[Scalar]
    w: list[Array]

    def apply(self, f: Array, at: slice = slice(None), to: slice = slice(None)) -> Array:
        """Return P f, the acceleration due to a wrench f, or that of some rows due to a wrench on some rows."""
        summands = [D * (w[at] @ f) * w[to] for D, w in zip(self.D, self.w, strict=True)]
        return sum(summands, start=np.zeros(len(summands[0]) if summands else 0))

    def dense(self) -> Array:
        """Return P, (6, 6)."""
        W = array(self.w).T
        return (W * array(self.D)) @ W.T

    def plus(self, D: list[Scalar], w: list[Array]) -> FactoredMobility:
        """Return P + sum D w w^T."""
        return FactoredMobility([*self.D, *D], [*self.w, *w]).limited()

    def limited(self) -> FactoredMobility:
        """Return the same mobility in as many factors as rows, if there are more than twice as many."""
        return self.compressed() if self.w and len(self.D) > 2 * len(self.w[0]) else self

    def compressed(self) -> FactoredMobility:
        """Return the same mobility in as many factors as rows, P = U diag(D) U^T, by weighted Gram-Schmidt.

        The part of row j of W that is orthogonal to the rows after it has the weight D_j = sum_k D_k W_jk^2 (the time
        update of the filter by C. L. Thornton and G. J. Bierman, 1976). No mobilities are subtracted.
        """
        W, D = [array(row) for row in array(self.w).T], array(self.D)
        found: list[Scalar] = [0.0] * len(W)
        U = [[1.0 if i == j else 0.0 for j in range(len(W))] for i in range(len(W))]
        for j in reversed(range(len(W))):
            weighted = D * W[j]
            found[j] = weighted @ W[j]
            alive = found[j] > 0.0
            inverse = where(alive, 1.0 / where(alive, found[j], 1.0), 0.0)
            for i in range(j):
                U[i][j] = (weighted @ W[i]) * inverse
                W[i] = W[i] - U[i][j] * W[j]
        return FactoredMobility(found, [array(column) for column in array(U).T])


def factored(P: Array, size: Array) -> FactoredMobility:
    """Return the factors of a mobility given as a (6, 6) matrix; pivots that are only rounding become zero.

    Args:
        P: (6, 6) positive semidefinite.
        size: (6,) size of the terms from which each diagonal entry was summed.
    """
    return FactoredMobility(*largest_first(P, size, ZERO_PIVOT))


def updated(P: FactoredMobility, c: Array, d: Scalar, least: Scalar) -> tuple[FactoredMobility, Array, Scalar, Scalar]:
    """Return P after one row c, k = P c^T, sigma = c P c^T + d, and whether sigma > least.

    Bierman's update: with alpha_0 = d, alpha_j = alpha_{j-1} + D_j f_j^2, f_j = c w_j:
    D_j *= alpha_{j-1} / alpha_j,  w_j -= (f_j / alpha_{j-1}) sum_{i<j} D_i f_i w_i.
    A row that depends on earlier ones (sigma <= least) leaves P unchanged. Columns whose f_j is only the rounding of
    zero are skipped, because alpha would be so small that f_j / alpha overflows. The function must not be
    differentiated: where f_j = 0, the derivative of f_j is lost (docs/theory/derivatives.md).
    """
    f = [c @ w for w in P.w]
    summands = [D * fj * fj for D, fj in zip(P.D, f, strict=True)]
    sigma = sum(summands, start=d)
    alive = sigma > least
    seen = where(alive, NEGLIGIBLE_PART * sigma, float("inf"))
    alpha, k = d, np.zeros(len(c))
    D_new, w_new = [], []
    for D, w, fj, summand in zip(P.D, P.w, f, summands, strict=True):
        fj = where(summand > seen, fj, 0.0)
        v = D * fj
        above = alpha + v * fj
        some = alpha > 0.0
        w_new.append(w - where(some, fj / where(some, alpha, 1.0), 0.0) * k)  # k = 0 if alpha = 0
        any_yet = above > 0.0
        D_new.append(where(any_yet, D * (alpha / where(any_yet, above, 1.0)), D))
        k = k + v * w
        alpha = above
    return FactoredMobility(D_new, w_new), k, sigma, alive
