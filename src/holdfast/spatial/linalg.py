"""Small dense factorisations that run on any scalar: no pivoting on values, no NumPy solver."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.spatial.scalar import Array, Scalar, array, concatenate, maximum, reciprocal, sqrt, where
from holdfast.spatial.vector import outer

RANK_TOLERANCE = 1e-12


class MaskedLDL(NamedTuple):
    """S = L diag(d) L^T with the pivots below a tolerance taken as absent.

    Attributes:
        L: (n, n) unit lower triangular.
        pivots: (n,) d, and 0 where the pivot was dropped.
        inverse_pivots: (n,) 1/d, and 0 where the pivot was dropped.
        kept: how many pivots were kept: the rank.
        weakest: the smallest kept pivot, relative to its scale (1 if none).
    """

    L: Array
    pivots: Array
    inverse_pivots: Array
    kept: Scalar
    weakest: Scalar


def ldl(S: Array, scale: Array, tolerance: float = RANK_TOLERANCE) -> MaskedLDL:
    """Factorise a positive semidefinite matrix without pivoting, dropping null pivots.

    A pivot d_j <= tolerance * scale_j is a rounding residue of zero: 1/d_j := 0. The
    solution is then one of the solutions whenever there is one (beyond.md 1, "Rank").

    Args:
        S: (n, n) symmetric.
        scale: (n,) size of each diagonal entry before anything was subtracted from it.
        tolerance: relative size of a pivot that counts as zero.

    Returns:
        The factors and the rank. Cost n^3/3 + O(n^2).
    """
    n = len(S)
    rest, columns, pivots, inverse = S, [], [], []
    kept, largest = 0, 1.0  # largest scale over pivot
    for j in range(n):
        pivot, size = rest[0, 0], scale[j]
        alive = pivot > tolerance * size
        inv = where(alive, 1.0 / where(alive, pivot, 1.0), 0.0)
        largest = maximum(largest, size * inv)
        kept = kept + where(alive, 1, 0)
        pivots.append(where(alive, pivot, 0.0))
        inverse.append(inv)
        below = rest[1:, 0] * inv
        columns.append(concatenate([np.zeros(j), [1.0], below]))
        rest = rest[1:, 1:] - outer(below, rest[1:, 0])
    return MaskedLDL(array(columns).T, array(pivots), array(inverse), kept, 1.0 / largest)


def ldl_solve(factors: MaskedLDL, b: Array) -> Array:
    """Return S^-1 b (a solution of S x = b where pivots were dropped); b is (n,) or (n, m)."""
    y = forward_substitution(factors.L, b)
    z = (y.T * factors.inverse_pivots).T
    return back_substitution(factors.L, z)


def least_solution(A: Array, b: Array) -> Array:
    """Return the least x that brings A x nearest to b: A^T (A A^T)^+ b.

    Null pivots of A A^T are dropped; its null vectors, one a dropped pivot, are taken out of b
    first, so that what A cannot reach leaves the rest of b alone.

    Args:
        A: (m, n); singular values below 1e-6 of the largest count as zero.
        b: (m,).
    """
    m, S = len(A), A @ A.T
    factors = ldl(S, np.diag(S))
    null = back_substitution(factors.L, np.eye(m)).T  # row k: L^-T e_k
    taken: list[tuple[Array, Scalar]] = []
    for k in range(m):
        u = null[k]
        for v, inverse in taken:
            u = u - (v @ u) * inverse * v
        dropped = factors.pivots[k] <= 0.0
        taken.append((u, where(dropped, 1.0 / where(dropped, u @ u, 1.0), 0.0)))
        b = b - (u @ b) * taken[-1][1] * u
    return A.T @ ldl_solve(factors, b)


def cholesky(S: Array) -> Array:
    """Return the lower triangular C with C C^T = S, S positive definite (not checked)."""
    n = len(S)
    rest, columns = S, []
    for j in range(n):
        diagonal = sqrt(rest[0, 0])
        below = rest[1:, 0] * reciprocal(diagonal)  # one division a column
        columns.append(concatenate([np.zeros(j), [diagonal], below]))
        rest = rest[1:, 1:] - outer(below, below)
    return array(columns).T


def forward_substitution(L: Array, b: Array) -> Array:
    """Return L^-1 b for a lower triangular L; b is (n,) or (n, m)."""
    rows = []
    for j in range(len(L)):
        known = sum((L[j, i] * rows[i] for i in range(j)), start=0.0 * b[j])
        rows.append((b[j] - known) * reciprocal(L[j, j]))  # one division for all columns
    return array(rows)


def back_substitution(L: Array, b: Array) -> Array:
    """Return L^-T b for a lower triangular L; b is (n,) or (n, m)."""
    n = len(L)
    rows: list[Array] = [b[0]] * n
    for j in reversed(range(n)):
        known = sum((L[i, j] * rows[i] for i in range(j + 1, n)), start=0.0 * b[j])
        rows[j] = (b[j] - known) * reciprocal(L[j, j])
    return array(rows)
