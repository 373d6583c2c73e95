"""The updates of a filter by one arm: a parallel sum of two mobilities for a rigid grasp, else row by row.

With a rigid grasp, the mobility about G becomes its parallel sum with the mobility of the arm. With other grasps, the
rows of the arm are made independent of each other first, and then included one after the other.

An update consists of factors, which do not depend on the right-hand side, and of two functions that use them for any
right-hand side: `forward` includes r in x, and `back` finds the wrench of the arm from that of all arms after it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.closed.factored_mobility import FactoredMobility, updated
from holdfast.dynamics.closed.measurement import Measurement
from holdfast.spatial.linalg import RANK_TOLERANCE, MaskedLDL, back_substitution, halfway, ldl, ldl_solve
from holdfast.spatial.scalar import Array, Scalar, array, minimum, select, where
from holdfast.spatial.symmetric import mirrored
from holdfast.spatial.vector import outer

# A pivot of K Lambda K^T that is smaller than this, relative to its scale, is rounding: the arm cannot move there.
NEGLIGIBLE_PIVOT = 1e-15
EQUAL_PIVOTS = 1e-12  # scaled pivots that differ by less count as equal


class Included(NamedTuple):
    """What including an arm changes, beside the right-hand side.

    Attributes:
        X: (n, c) response of the open accelerations to the columns, after the arm.
        P: mobility after the arm, (6, 6) or in factors.
        N: (c, c) inertia that its grasp adds to the equations of the columns, E^T S^-1 E.
        kept: number of its rows that are independent of the rows before.
        weakest: the smallest pivot of these rows, relative to a typical one.
        independent: (rows,) 1 for the independent rows, if the contact has a mask of rows.
    """

    X: Array
    P: Any
    N: Array
    kept: Scalar
    weakest: Scalar
    independent: Array | None = None


class ParallelSum(NamedTuple):
    """The update by an arm with a rigid grasp.

    S = P + R,  Gt = S^-1 P,  E = X_arm - X,  nu = S^-1 (r - x);  x += P nu,  P = P S^-1 R = Gt^T R. No mobilities are
    subtracted, and R may be singular (docs/theory/sequential_filter.md). Zero pivots of S are skipped.

    Attributes:
        S: the factors of S.
        P: (6, 6) mobility before.
        gain: (6, 6) Gt.
        half: (6, c) L^-1 E.
        columns: (6, c) S^-1 E.
    """

    S: MaskedLDL
    P: Array
    gain: Array
    half: Array
    columns: Array

    def forward(self, x: Array, r: Array) -> tuple[Array, Array, Array]:
        """Return x after the arm, its load (c,) on the columns, and nu for the way back."""
        u = halfway(self.S, r - x)[1]
        nu = back_substitution(self.S.L, u)
        return x + self.P @ nu, self.half.T @ u, nu

    def back(self, s: Array, nu: Array, beta: Array) -> Array:
        """Return the wrench of the arm at G, for that of all arms after it and the accelerations of the columns."""
        return nu + self.columns @ beta - self.gain @ s


def parallel_sum(X: Array, P: Array, m: Measurement, size: Array) -> tuple[Included, ParallelSum]:
    """Return the update by an arm with a rigid grasp.

    Args:
        X: (6, c) response of alpha(G) to the columns.
        P: (6, 6) mobility there.
        m: the arm's measurement.
        size: (3,) size of P, for judging pivots.
    """
    S = ldl(P + m.R, m.pivot_sizes(size), RANK_TOLERANCE, m.typical_pivots(size))
    gain = ldl_solve(S, P)
    v, u = halfway(S, m.X - X)
    columns = back_substitution(S.L, u)
    included = Included(X + P @ columns, mirrored(gain.T @ m.R), v.T @ u, S.kept, S.weakest)
    return included, ParallelSum(S, P, gain, v, columns)


class TerminalSum(NamedTuple):
    """The update by the last arm, if its grasp is rigid; only back-substitution follows.

    z = S^-1 P w:  lambda = nu - z,  alpha(G) = x + P nu + R z, because P S^-1 R = R S^-1 P. The load of the external
    wrench w on the columns is X^T w with X after the update, which is X^T w + E^T z. Two solves instead of seven.

    Attributes:
        S: the factors of S.
        X: (6, c) response of alpha(G) to the columns, before the arm.
        P: (6, 6) mobility before.
        R: (6, 6) mobility of the arm.
        half: (6, c) L^-1 E.
        halfway: (6, c) D^-1 L^-1 E.
    """

    S: MaskedLDL
    X: Array
    P: Array
    R: Array
    half: Array
    halfway: Array

    def forward(self, x: Array, r: Array, w: Array) -> tuple[Array, tuple[Array, Array, Array]]:
        """Return the load (c,) on the columns, and what the way back needs; w (6,) is the external wrench about G."""
        u, under_w = halfway(self.S, r - x)[1], halfway(self.S, self.P @ w)[1]
        return self.half.T @ (u - under_w) - w @ self.X, (x, u, under_w)

    def back(self, kept: tuple[Array, Array, Array], beta: Array) -> tuple[Array, Array]:
        """Return alpha(G), and the wrench of the arm at G, for the accelerations of the columns."""
        x, u, under_w = kept
        nu, z = back_substitution(self.S.L, np.column_stack([u + self.halfway @ beta, under_w])).T
        return x + self.X @ beta + self.P @ nu + self.R @ z, nu - z


def terminal_sum(X: Array, P: Array, m: Measurement, size: Array) -> tuple[Included, TerminalSum]:
    """Return the update by the last arm; arguments as in `parallel_sum`."""
    S = ldl(P + m.R, m.pivot_sizes(size), RANK_TOLERANCE, m.typical_pivots(size))
    v, u = halfway(S, m.X - X)
    included = Included(X, mirrored(ldl_solve(S, P).T @ m.R), v.T @ u, S.kept, S.weakest)
    return included, TerminalSum(S, X, P, m.R, v, u)


class IncludedRow(NamedTuple):
    """One row of an arm that has been included.

    Attributes:
        c: (n,) its coefficients.
        k: (n,) P c^T.
        inverse: 1 / sigma; 0 for a dependent row.
        gain: (n,) k / sigma.
        e: (c,) what the columns leave of the row.
        nu: (c,) e / sigma.
    """

    c: Array
    k: Array
    inverse: Scalar
    gain: Array
    e: Array
    nu: Array


class RowSums(NamedTuple):
    """The update by an arm whose rows are included one after the other.

    For each independent row c z = r - d lambda: sigma = c P c^T + d, k = P c^T, nu = (r - c x) / sigma, x += k nu,
    P -= k k^T / sigma. Backward: lambda = nu - (k . s) / sigma, s += c^T lambda.

    Attributes:
        rows: the rows.
        made_independent: function that makes a right-hand side independent; see `independent_rows`.
    """

    rows: list[IncludedRow]
    made_independent: Callable[[Array], Array]

    def forward(self, x: Array, r: Array) -> tuple[Array, Array, list[Scalar]]:
        """Return x after the arm, its load (c,) on the columns, and nu of every row for the way back."""
        load, nus = np.zeros(len(self.rows[0].e) if self.rows else 0), []
        for row, one in zip(self.rows, self.made_independent(r), strict=True):
            nu = (one - row.c @ x) * row.inverse
            x, load = x + nu * row.k, load + row.e * nu
            nus.append(nu)
        return x, load, nus

    def back(self, s: Array, nus: list[Scalar], beta: Array) -> Array:
        """Return C^T lambda, the wrench of the arm at G, for that of all arms after it."""
        return self.forces(s, nus, beta)[0]

    def forces(self, s: Array, nus: list[Scalar], beta: Array) -> tuple[Array, list[Scalar]]:
        """Return C^T lambda, and lambda of every row, the last one first."""
        from_arm, found = np.zeros(len(s)), []
        for row, nu in zip(reversed(self.rows), reversed(nus), strict=True):
            found.append(nu + row.nu @ beta - row.gain @ (s + from_arm))
            from_arm = from_arm + found[-1] * row.c
        return from_arm, found


def included_row(
    X: Array, P: FactoredMobility, c: Array, d: Scalar, e: Array, least: Scalar
) -> tuple[FactoredMobility, IncludedRow, Scalar, Scalar]:
    """Return the mobility after one row, the row, sigma, and whether sigma > `least`; see `RowSums` and `updated`.

    Args:
        X: (n, c) response of the open accelerations to the columns.
        P: their mobility.
        c: (n,) its coefficients.
        d: its noise.
        e: (c,) its coefficients of the columns, on the right-hand side.
        least: a smaller sigma is zero.
    """
    P, k, sigma, alive = updated(P, c, d, least)
    inverse = where(alive, 1.0 / where(alive, sigma, 1.0), 0.0)
    left = e - c @ X
    return P, IncludedRow(c, k, inverse, inverse * k, left, inverse * left), sigma, alive


def row_sums(
    X: Array,
    P: FactoredMobility,
    m: Measurement,
    scale: Array,
    typical: Array,
    tolerance: float = RANK_TOLERANCE,
    found: IndependentRows | None = None,
) -> tuple[Included, RowSums]:
    """Return the update by an arm whose rows are included one after the other.

    Args:
        X: (n, c) response of the open accelerations to the columns.
        P: their mobility.
        m: the arm's measurement.
        scale: (rows,) sizes of the terms in the pivots.
        typical: (rows,) typical pivots.
        tolerance: relative size of a pivot that counts as zero.
        found: its rows with a diagonal R; by default `independent_rows`.
    """
    count = X.shape[1]
    N, kept, weakest = np.zeros((count, count)), np.zeros(())[()], np.ones(())[()]
    independent: Array | None = None if m.held is None else np.zeros(len(m.held))
    found = independent_rows(m, scale, typical) if found is None else found
    included = []
    for row, d, e, (size, usual), which in zip(*found[:-1], strict=True):
        P, own, sigma, alive = included_row(X, P, row, d, e, tolerance * size)
        X, N = X + outer(own.k, own.nu), N + outer(own.e, own.nu)
        included.append(own)
        kept = kept + where(alive, 1, 0)
        weakest = minimum(weakest, where(alive, sigma / where(alive, usual, 1.0), 1.0))
        if independent is not None:
            independent = independent + which * where(alive, 1.0, 0.0)
    return Included(X, P, N, kept, weakest, independent), RowSums(included, found.made_independent)


class IndependentRows(NamedTuple):
    """The rows of one arm with a diagonal R, in the chosen order.

    Attributes:
        C: (rows, n) L^-1 C.
        d: >= 0, the diagonal of R.
        X: (rows, c) L^-1 X.
        sizes: (rows, 2) the scale of each row, and its typical pivot.
        which: (rows, rows) 1 for the original row, if rows have a mask; otherwise (rows, 0).
        made_independent: function that applies L^-1, in the chosen order, to a right-hand side (rows,) or (rows, m).
    """

    C: Array
    d: list[Scalar]
    X: Array
    sizes: Array
    which: Array
    made_independent: Callable[[Array], Array]


def independent_rows(m: Measurement, scale: Array, typical: Array) -> IndependentRows:
    """Return the rows of one arm with a diagonal R, from the factorisation R = L diag(d) L^T.

    The row with the largest remaining pivot comes first. The entries of L are therefore at most one, and the zero
    pivots of an arm with few joints, whose quotients are meaningless, come last.

    Args:
        m: the arm's measurement.
        scale: (rows,) sizes of the rows.
        typical: (rows,) typical pivots.
    """
    count, n = m.C.shape
    numbers = n + m.X.shape[1]  # number of columns of L^-1 [C, X]; the sizes follow
    inverse_size = numbers + 2
    inverse_sizes = array([where(size > 0.0, 1.0 / where(size > 0.0, size, 1.0), 0.0) for size in m.own_sizes()])
    which = np.eye(count) if m.held is not None else np.zeros((count, 0))
    R, rows = m.R, np.column_stack([m.C, m.X, scale, typical, inverse_sizes, which])
    d: list[Scalar] = []
    steps: list[tuple[int, list[tuple[int, Scalar]], Array | None]] = []  # row, exchanges with others, multipliers

    def made_independent(r: Array) -> Array:
        for j, exchanges, below in steps:
            for i, exchanged in exchanges:
                r = select(exchanged > 0.5, r[exchange(count, i, j)], r)
            if below is not None:
                taken = below * r[j] if r.ndim == 1 else outer(below, r[j])
                r = np.concatenate([r[: j + 1], r[j + 1 :] - taken])
        return r

    for j in range(count):
        exchanges: list[tuple[int, Scalar]] = []
        for i in range(j + 1, count):
            order = exchange(count, i, j)
            # by more than rounding, so that rows that are equally immobile keep their order
            larger = R[i, i] * rows[i, inverse_size] > R[j, j] * rows[j, inverse_size] + EQUAL_PIVOTS
            R = select(larger, R[np.ix_(order, order)], R)
            rows = select(larger, rows[order], rows)
            exchanges.append((i, where(larger, 1.0, 0.0)))
        if j >= m.most:  # the remainder of R is only rounding
            steps.append((j, exchanges, None))
            d += [0.0] * (count - j)
            break
        alive = R[j, j] * rows[j, inverse_size] > NEGLIGIBLE_PIVOT
        d.append(where(alive, R[j, j], 0.0))
        below: Array = R[j + 1 :, j] * where(alive, 1.0 / where(alive, R[j, j], 1.0), 0.0)
        rest = R[j + 1 :, j + 1 :] - outer(below, R[j, j + 1 :])
        R = np.concatenate([R[: j + 1], np.hstack([R[j + 1 :, : j + 1], rest])])
        rest_of_row = np.zeros((len(below), rows.shape[1] - numbers))
        less = np.column_stack([outer(below, rows[j, :numbers]), rest_of_row])
        rows = np.concatenate([rows[: j + 1], rows[j + 1 :] - less])
        steps.append((j, exchanges, below))
    return IndependentRows(
        rows[:, :n], d, rows[:, n:numbers], rows[:, numbers:inverse_size], rows[:, inverse_size + 1 :], made_independent
    )


def exchange(count: int, i: int, j: int) -> list[int]:
    """Return the order of `count` rows with rows i and j exchanged."""
    order = list(range(count))
    order[i], order[j] = j, i
    return order
