"""Small dense factorisations and solvers; all but `gauss_solve` run on any scalar: no pivoting on values."""

from __future__ import annotations

from functools import reduce
from typing import Any, NamedTuple

import numpy as np

from holdfast.spatial.scalar import Array, Scalar, array, concatenate, maximum, reciprocal, select, sqrt, where
from holdfast.spatial.symmetric import mirrored
from holdfast.spatial.vector import outer

RANK_TOLERANCE = 1e-12


class MaskedLDL(NamedTuple):
    """The factorisation S = L diag(d) L^T, in which pivots below a tolerance are dropped.

    Attributes:
        L: (n, n) unit lower triangular.
        pivots: (n,) d, and 0 where the pivot was dropped.
        inverse_pivots: (n,) 1/d, and 0 where the pivot was dropped.
        kept: number of kept pivots, which is the rank.
        weakest: the smallest kept pivot, relative to a typical one; 1 if none is kept.
    """

    L: Array
    pivots: Array
    inverse_pivots: Array
    kept: Scalar
    weakest: Scalar


def ldl(S: Array, scale: Array, tolerance: float = RANK_TOLERANCE, typical: Array | None = None) -> MaskedLDL:
    """Factorise a positive semidefinite matrix in the given order, dropping null pivots.

    A pivot d_j <= tolerance * size_j is zero up to rounding, and 1/d_j is set to 0. If S x = b has solutions, the
    result is one of them (docs/theory/sequential_filter.md, "Rank"). The size of a row bounds its rounding error. It
    begins with scale_j; when L_ij times row j is subtracted from row i, the rounding error of row j is added to that of
    row i: size_i + L_ij^2 size_j. Without this, a null row after a small pivot would seem to be regular, because its
    rounding error is divided by that pivot.

    Args:
        S: (n, n) symmetric.
        scale: (n,) size of the terms of which each diagonal entry is the sum.
        tolerance: relative size of a pivot that counts as zero.
        typical: (n,) typical pivots, to which the smallest kept one is compared; by default `scale`.

    Returns:
        The factors and the rank. Cost n^3/3 + O(n^2).
    """
    n, typical = len(S), scale if typical is None else typical
    rest, size, columns, pivots, inverse = S, scale, [], [], []
    kept, largest = 0, 1.0  # largest typical pivot over pivot
    for j in range(n):
        pivot = rest[0, 0]
        alive = pivot > tolerance * size[0]
        inv = where(alive, 1.0 / where(alive, pivot, 1.0), 0.0)
        largest = maximum(largest, typical[j] * inv)
        kept = kept + where(alive, 1, 0)
        pivots.append(where(alive, pivot, 0.0))
        inverse.append(inv)
        below = rest[1:, 0] * inv
        columns.append(concatenate([np.zeros(j), [1.0], below]))
        rest = rest[1:, 1:] - outer(below, rest[1:, 0])
        size = size[1:] + below * below * size[0]
    return MaskedLDL(array(columns).T, array(pivots), array(inverse), kept, 1.0 / largest)


def ldl_solve(factors: MaskedLDL, b: Array) -> Array:
    """Return S^-1 b (a solution of S x = b where pivots were dropped); b is (n,) or (n, m)."""
    return back_substitution(factors.L, halfway(factors, b)[1])


def halfway(factors: MaskedLDL, b: Array) -> tuple[Array, Array]:
    """Return v = L^-1 b and u = D^-1 v, with which S^-1 b = L^-T u and b^T S^-1 b = v^T u; b is (n,) or (n, m)."""
    v = forward_substitution(factors.L, b)
    return v, (v.T * factors.inverse_pivots).T


def largest_first(S: Array, size: Array, tolerance: float = RANK_TOLERANCE) -> tuple[list[Scalar], list[Array]]:
    """Factorise a positive semidefinite matrix into sum_k d_k w_k w_k^T, the largest pivot first.

    d_k is the largest remaining diagonal entry, relative to its size, and w_k is its column divided by d_k; then
    d_k w_k w_k^T is subtracted from S. Therefore no entry of w_k is much larger than one, and null pivots come last.

    Args:
        S: (n, n) symmetric.
        size: (n,) size of the terms of which each diagonal entry is the sum.
        tolerance: relative size of a pivot that counts as zero.

    Returns:
        n factors >= 0 and as many columns (n,); both are zero for a null pivot.
    """
    n = len(S)
    d, w = [], []
    for _ in range(n):
        pivot, of, column = S[0, 0], size[0], S[:, 0]
        for i in range(1, n):
            more = S[i, i] * of > pivot * size[i]
            pivot, of, column = where(more, S[i, i], pivot), where(more, size[i], of), select(more, S[:, i], column)
        alive = pivot > tolerance * of
        d.append(where(alive, pivot, 0.0))
        w.append(column * where(alive, 1.0 / where(alive, pivot, 1.0), 0.0))
        S = mirrored(S - outer(d[-1] * w[-1], w[-1]))
    return d, w


def least_solution(A: Array, b: Array) -> Array:
    """Return the least-squares solution of A x = b with the smallest norm, A^T (A A^T)^+ b.

    Args:
        A: (m, n), rows in one unit; singular values below 1e-6 of the largest count as zero.
        b: (m,).
    """
    if not len(A):
        return np.zeros(A.shape[1])
    return A.T @ pseudo_solution(A @ A.T, b)


def pseudo_solution(S: Array, b: Array) -> Array:
    """Return S^+ b for a positive semidefinite matrix, the least-squares solution with the smallest norm.

    With S = W D W^T, the largest remaining diagonal entry first, the pseudo-inverse is W G D^+ G W^T, where
    G = (W^T W)^+.

    Args:
        S: (m, m), rows in one unit; eigenvalues below 1e-12 of the largest diagonal entry count as zero.
        b: (m,).
    """
    n, least = len(S), RANK_TOLERANCE * reduce(maximum, np.diag(S), 0.0)
    rest: list[list[Any]] = S.tolist()  # of which the lower triangle counts
    known: list[list[Any]] = [[0.0] * n for _ in range(n)]
    right: list[Any] = b.tolist()
    inverse, exchanges = list[Scalar](), list[tuple[Scalar, int, int]]()
    for k in range(n):
        for i in range(k + 1, n):
            exchanges.append((rest[i][i] > rest[k][k], k, i))
            _exchange(*exchanges[-1], rest, known, right)
        pivot = rest[k][k]
        alive = pivot > least
        inverse.append(where(alive, 1.0 / where(alive, pivot, 1.0), 0.0))
        known[k][k] = where(alive, 1.0, 0.0)
        for i in range(k + 1, n):
            known[i][k] = rest[i][k] * inverse[k]
            for j in range(k + 1, i + 1):
                rest[i][j] = rest[i][j] - known[i][k] * rest[j][k]
    W = array(known)
    null = np.diag([1.0 - row[k] for k, row in enumerate(W)])  # of columns of zeros
    L, pivots = root_free_cholesky(W.T @ W + null)
    y = back_substitution(L, forward_substitution(L, W.T @ array(right)) * reciprocal(pivots))
    x = W @ back_substitution(L, forward_substitution(L, array(inverse) * y) * reciprocal(pivots))
    for condition, k, i in reversed(exchanges):
        x[k], x[i] = where(condition, x[i], x[k]), where(condition, x[k], x[i])
    return x


def _exchange(condition: Scalar, k: int, i: int, S: list[list[Any]], W: list[list[Any]], b: list[Any]) -> None:
    """Exchange rows k and i > k of S, of its columns as well, of W, and of b, in place, if the condition holds.

    Args:
        condition: the condition.
        k: a row, of which S has columns from k on.
        i: another one.
        S: a symmetric matrix, of which the lower triangle counts.
        W: a matrix with the columns 0 to k - 1.
        b: a vector.
    """
    pairs = [((S[k], k), (S[i], i)), ((b, k), (b, i))]
    pairs += [((W[k], j), (W[i], j)) for j in range(k)]
    pairs += [((S[j], k), (S[max(i, j)], min(i, j))) for j in range(k + 1, len(b)) if j != i]
    for (one, p), (other, q) in pairs:
        one[p], other[q] = where(condition, other[q], one[p]), where(condition, one[p], other[q])


def in_range(A: Array, b: Array, rank: int) -> Array:
    """Return the part of a vector in the range of a matrix of known rank, A A^+ b, whatever the lengths of columns.

    Gram-Schmidt, with columns of unit length and the largest remaining one first.

    Args:
        A: (m, n).
        b: (m,).
        rank: its rank, at most min(m, n); the last n - rank columns, which remain of rounding alone, are left out.
    """
    columns, basis, found = [_unit(a) for a in A.T], [], 0.0 * b
    for _ in range(rank):
        sizes = [a @ a for a in columns]
        u, size = columns[0], sizes[0]
        for j in range(1, len(columns)):
            more = sizes[j] > size
            u, columns[j] = select(more, columns[j], u), select(more, u, columns[j])
            size = where(more, sizes[j], size)
        for before in basis:  # once more, because what has been subtracted may have been much larger
            u = u - (u @ before) * before
        u = _unit(u)
        columns = [a - (a @ u) * u for a in columns[1:]]
        basis.append(u)
        found = found + (u @ b) * u
    return found


def shortest_solution(A: Array, b: Array, tolerance: float) -> Array:
    """Return the shortest solution of equations A x = b that have one, (n,).

    Gram-Schmidt on the rows of [A | b], the largest remaining one first, gives U x = y with orthonormal rows, and
    x = U^T y. Unlike `least_solution`, it does not square the condition. O(m n min(m, n)).

    Args:
        A: (m, n), rows in one unit.
        b: (m,) in the range of A; what is not is ignored.
        tolerance: length of a remaining row, relative to the longest of A, up to which it is zero.
    """
    m, n = A.shape
    rows, basis, least, found = [concatenate([a, [x]]) for a, x in zip(A, b, strict=True)], [], 0.0, np.zeros(n)
    for k in range(min(m, n)):
        u, size = rows[0], rows[0][:n] @ rows[0][:n]
        for j in range(1, len(rows)):
            own = rows[j][:n] @ rows[j][:n]
            more = own > size
            u, rows[j] = select(more, rows[j], u), select(more, u, rows[j])
            size = where(more, own, size)
        least = tolerance * tolerance * size if k == 0 else least
        for before in basis:  # once more, because what has been subtracted may have been much larger
            u = u - (u[:n] @ before[:n]) * before
        size = u[:n] @ u[:n]
        alive = size > least
        u = u * where(alive, 1.0 / sqrt(where(alive, size, 1.0)), 0.0)
        rows = [a - (a[:n] @ u[:n]) * u for a in rows[1:]]
        basis.append(u)
        found = found + u[n] * u[:n]
    return found


def _unit(a: Array) -> Array:
    """Return a vector divided by its length; zero remains zero."""
    size = a @ a
    return a * where(size > 0.0, 1.0 / sqrt(where(size > 0.0, size, 1.0)), 0.0)


def cholesky(S: Array, lost: Array | None = None) -> Array:
    """Return the lower triangular C with C C^T = S.

    Args:
        S: (n, n) symmetric positive definite, which is not checked.
        lost: (n,) pivots up to which nothing but rounding is left; 1 takes their place, and 0 that of what is below
            them. None for none.
    """
    n = len(S)
    rest, columns = S, []
    for j in range(n):
        pivot, alive = rest[0, 0], lost is None or rest[0, 0] > lost[j]
        diagonal = sqrt(pivot if lost is None else where(alive, pivot, 1.0))
        inverse = reciprocal(diagonal)  # one division a column
        below = rest[1:, 0] * (inverse if lost is None else where(alive, inverse, 0.0))
        columns.append(concatenate([np.zeros(j), [diagonal], below]))
        rest = rest[1:, 1:] - outer(below, below)
    return array(columns).reshape(n, n).T


def root_free_cholesky(S: Array) -> tuple[Array, Array]:
    """Return L, lower triangular with ones on its diagonal, and D, (n,), with L diag(D) L^T = S.

    Args:
        S: (n, n) symmetric positive definite, which is not checked.
    """
    n, rest, columns, pivots = len(S), S, [], []
    for j in range(n):
        pivots.append(rest[0, 0])
        below = rest[1:, 0] * reciprocal(rest[0, 0])
        columns.append(concatenate([np.zeros(j), [1.0], below]))
        rest = rest[1:, 1:] - outer(below, rest[1:, 0])
    return array(columns).reshape(n, n).T, array(pivots)


def forward_substitution(L: Array, b: Array) -> Array:
    """Return L^-1 b for a lower triangular L; b is (n,) or (n, m)."""
    rows = []
    for j in range(len(L)):
        known = sum((L[j, i] * rows[i] for i in range(j)), start=0.0 * b[j])
        rows.append((b[j] - known) * reciprocal(L[j, j]))  # one division for all columns
    return array(rows).reshape(b.shape)


def back_substitution(L: Array, b: Array) -> Array:
    """Return L^-T b for a lower triangular L; b is (n,) or (n, m)."""
    n = len(L)
    rows: list[Array] = list(b)
    for j in reversed(range(n)):
        known = sum((L[i, j] * rows[i] for i in range(j + 1, n)), start=0.0 * b[j])
        rows[j] = (b[j] - known) * reciprocal(L[j, j])
    return array(rows).reshape(b.shape)


def lu(A: Array) -> tuple[Array, Array]:
    """Return L and U with L U = A, L with ones on its diagonal, eliminating in the given order. 2 n^3/3.

    Args:
        A: (n, n), whose pivots in this order must not vanish: a positive definite symmetric part suffices.
    """
    n, rest, columns, rows = len(A), A, [], []
    for j in range(n):
        below = rest[1:, 0] * reciprocal(rest[0, 0])
        columns.append(concatenate([np.zeros(j), [1.0], below]))
        rows.append(concatenate([np.zeros(j), rest[0]]))
        rest = rest[1:, 1:] - outer(below, rest[0, 1:])
    return array(columns).T, array(rows)


def lu_solve(factors: tuple[Array, Array], b: Array) -> Array:
    """Return A^-1 b with the factors of `lu`; b is (n,) or (n, m)."""
    L, U = factors
    return back_substitution(U.T, forward_substitution(L, b))


def without_overflow(x: Array, axis: int | None = None) -> Array:
    """Return an array divided by a power of two, along an axis or as a whole, so that its largest entry is near 1.

    No digit is lost, and the squares of the entries cannot overflow. For floats only.
    """
    return np.ldexp(x, -np.frexp(np.abs(x).max(axis=axis))[1])


NULL_PIVOT = 1e-13


def gauss_solve(matrix: Array, rhs: Array) -> tuple[Array, int]:
    """Return x with matrix x = rhs, and the nullity, by elimination with complete pivoting.

    Rows and columns are first scaled by powers of two to entries of about 1 (exact), so
    that neither units nor a light object decide what counts as null.

    Args:
        matrix: (n, n).
        rhs: (n,).

    Returns:
        (n,) solution, meaningless if the nullity is not 0; the number of null pivots.
    """
    n = len(matrix)
    rows, columns = _power_of_two_scales(_values(matrix))
    A = np.array((matrix.T * rows).T * columns)
    b = np.array(rhs * rows)
    place = np.arange(n)  # of the unknowns, as columns are exchanged
    for j in range(n):
        sizes = np.abs(_values(A[j:, j:]))
        row, column = (j + int(k) for k in np.unravel_index(np.argmax(sizes), sizes.shape))
        if sizes.max() <= NULL_PIVOT:
            return 0.0 * rhs, n - j
        A[[j, row]], b[[j, row]] = A[[row, j]], b[[row, j]]
        A[:, [j, column]], place[[j, column]] = A[:, [column, j]], place[[column, j]]
        factors = A[j + 1 :, j] / A[j, j]
        A[j + 1 :, j + 1 :] = A[j + 1 :, j + 1 :] - outer(factors, A[j, j + 1 :])
        b[j + 1 :] = b[j + 1 :] - factors * b[j]
    x = b
    for j in reversed(range(n)):
        x[j] = (b[j] - A[j, j + 1 :] @ x[j + 1 :]) / A[j, j]
    found = np.array(x)
    found[place] = x
    return found * columns, 0


def _values(entries: Array) -> Array:
    """Return the entries as floats; a counting scalar carries its value."""
    return np.vectorize(lambda x: float(getattr(x, "value", x)), otypes=[float])(entries)


def _power_of_two_scales(A: Array) -> tuple[Array, Array]:
    """Return row and column factors, powers of two, that bring the entries near 1 (Ruiz)."""
    rows, columns = np.ones(len(A)), np.ones(len(A))
    for _ in range(8):
        scaled = np.abs((A.T * rows).T * columns)
        for factors, axis in ((rows, 1), (columns, 0)):
            size = scaled.max(axis=axis, initial=0.0)
            factors *= np.exp2(-np.round(0.5 * np.log2(np.where(size > 0, size, 1.0))))
    return rows, columns
