"""The updates of the object's filter by one arm: a parallel sum of two mobilities for a rigid grasp, else row by row.

With a rigid grasp, the mobility about G becomes its parallel sum with the mobility of the arm. With other grasps, the
rows of the arm are made independent of each other first, and then included one after the other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.dynamics.closed.factored_mobility import FactoredMobility, updated
from holdfast.dynamics.closed.measurement import BackSubstitution, Measurement, Update, of_beta
from holdfast.spatial.linalg import RANK_TOLERANCE, back_substitution, halfway, ldl, ldl_solve
from holdfast.spatial.scalar import Array, Scalar, array, minimum, select, where
from holdfast.spatial.symmetric import mirrored
from holdfast.spatial.vector import outer

# A pivot of K Lambda K^T that is smaller than this, relative to its scale, is rounding: the arm cannot move there.
NEGLIGIBLE_PIVOT = 1e-15
EQUAL_PIVOTS = 1e-12  # scaled pivots that differ by less count as equal


def rigid_update(x: Array, P: Array, m: Measurement, size: Array) -> tuple[Array, Array, Update]:
    """Return x and P after an arm with a rigid grasp, and its back-substitution.

    S = P + R,  Gt = S^-1 P,  nu = S^-1 (r - x);  x += P nu,  P = P S^-1 R = Gt^T R. No mobilities are subtracted, and R
    may be singular (docs/theory/sequential_filter.md). Zero pivots of S are skipped. With a trunk, the columns of the
    trunk follow in x and r.
    """
    S = ldl(P + m.R, m.pivot_sizes(size), RANK_TOLERANCE, m.typical_pivots(size))
    gain = ldl_solve(S, P)
    v, u = halfway(S, m.r - x)
    nu, on_trunk = back_substitution(S.L, u), None if u.ndim == 1 else v[:, 1:].T @ u

    def solve_rhs(x: Array, r: Array) -> tuple[Array, BackSubstitution]:
        nu = ldl_solve(S, r - x)
        return x + P @ nu, lambda s, beta=None: of_beta(nu, beta) - gain @ s

    update = Update(lambda s, beta=None: of_beta(nu, beta) - gain @ s, solve_rhs, S.kept, S.weakest, None, on_trunk)
    return x + P @ nu, mirrored(gain.T @ m.R), update


@dataclass(frozen=True, eq=False)
class TerminalUpdate:
    """The update by the last arm, if its grasp is rigid; only back-substitution follows.

    Attributes:
        solution: function of beta (c,) for the trunk's columns, or None, that returns alpha(G) (6,), which includes the
            effect of the external wrench on the object, and the wrench (6,) of the arm on the object, about G.
        mobility: (6, 6) P after the update.
        kept: number of its rows that are independent of the rows before.
        weakest: the smallest pivot of these rows, relative to a typical one.
        on_trunk: (c, 1 + c) [load | inertia] that the arm adds to the equations of the trunk's columns, including the
            load of the external wrench through all arms.
        solve_rhs: function of another x, r and w that returns acceleration and wrench, using the same factors; only
            without a trunk.
    """

    solution: Callable[..., tuple[Array, Array]]
    mobility: Array
    kept: Scalar
    weakest: Scalar
    on_trunk: Array | None
    solve_rhs: Callable[[Array, Array, Array], tuple[Array, Array]]


def terminal_update(x: Array, P: Array, m: Measurement, size: Array, w: Array) -> TerminalUpdate:
    """Return the result of `rigid_update` and its back-substitution for the last arm, by two solves instead of seven.

    z = S^-1 P w:  lambda = nu - z,  alpha(G) = x + P nu + R z, because P S^-1 R = R S^-1 P. The load of w on the
    trunk's columns is X^T w with X after the update, which is X^T w + (E - X)^T z.

    Args:
        x: acceleration of G of the object with the arms before.
        P: their mobility at G.
        m: the arm's measurement.
        size: (3,) size of P, for judging pivots.
        w: (6,) external wrench on the object about G.
    """
    S, e, on_trunk = ldl(P + m.R, m.pivot_sizes(size), RANK_TOLERANCE, m.typical_pivots(size)), m.r - x, None
    (v, u), (_, under_w) = halfway(S, e), halfway(S, P @ w)
    if e.ndim == 2:
        load = v[:, 1:].T @ (u[:, 0] - under_w) - w @ x[:, 1:]
        on_trunk = np.column_stack([load, v[:, 1:].T @ u[:, 1:]])

    def solution(beta: Array | None = None) -> tuple[Array, Array]:
        nu, z = back_substitution(S.L, np.column_stack([of_beta(u, beta), under_w])).T
        return of_beta(x, beta) + P @ nu + m.R @ z, nu - z

    def solve_rhs(x: Array, r: Array, w: Array) -> tuple[Array, Array]:
        nu, z = ldl_solve(S, np.column_stack([r - x, P @ w])).T
        return x + P @ nu + m.R @ z, nu - z

    return TerminalUpdate(solution, mirrored(ldl_solve(S, P).T @ m.R), S.kept, S.weakest, on_trunk, solve_rhs)


def row_updates(
    x: Array, P: FactoredMobility, m: Measurement, size: Array, tolerance: float = RANK_TOLERANCE
) -> tuple[Array, FactoredMobility, Update]:
    """Return x and P after one arm, and its back-substitution.

    For each independent row c alpha(G) = r - d lambda: sigma = c P c^T + d, k = P c^T, nu = (r - c x) / sigma,
    x += k nu, P -= k k^T / sigma. Backward: lambda = nu - (k . s) / sigma, s += c^T lambda.

    Args:
        x: acceleration of G of the object with the arms before.
        P: their mobility at G.
        m: the arm's measurement.
        size: (3,) size of P, for judging pivots.
        tolerance: relative size of a pivot that counts as zero.
    """
    rows: list[tuple[Array, Array, Any]] = []
    inverses: list[Scalar] = []
    width = 1 if m.r.ndim == 1 else m.r.shape[1]
    on_trunk = None if m.r.ndim == 1 else np.zeros((width - 1, width))
    independent: Array | None = None if m.held is None else np.zeros(len(m.held))
    kept: Scalar = 0
    weakest: Scalar = 1.0
    noises, ordered, made_independent = independent_rows(m, m.pivot_sizes(size), m.typical_pivots(size))
    for d, row in zip(noises, ordered, strict=True):
        c, (scale, typical) = row[:6], row[6 + width : 8 + width]
        r = row[6] if m.r.ndim == 1 else row[6 : 6 + width]
        P, k, sigma, alive = updated(P, c, d, tolerance * scale)
        inverse = where(alive, 1.0 / where(alive, sigma, 1.0), 0.0)
        e = r - c @ x
        nu = e * inverse
        x = x + (nu * k if on_trunk is None else outer(k, nu))
        rows.append((c, inverse * k, nu))
        inverses.append(inverse)
        kept = kept + where(alive, 1, 0)
        weakest = minimum(weakest, where(alive, sigma / where(alive, typical, 1.0), 1.0))
        if independent is not None:
            independent = independent + row[9 + width :] * where(alive, 1.0, 0.0)
        if on_trunk is not None:
            on_trunk = on_trunk + outer(e[1:], nu)

    def solve_rhs(x: Array, r: Array) -> tuple[Array, BackSubstitution]:
        others = []
        for (c, gain, _), inverse, one in zip(rows, inverses, made_independent(r), strict=True):
            e = one - c @ x
            x = x + (e * gain if r.ndim == 1 else outer(gain, e))
            others.append((c, gain, e * inverse))
        return x, back_through(others)

    return x, P, Update(back_through(rows), solve_rhs, kept, weakest, independent, on_trunk)


def back_through(rows: Sequence[tuple[Array, Array, Any]]) -> BackSubstitution:
    """Return the back-substitution through rows c, with their gains and innovations."""

    def back_substitute(s: Array, beta: Array | None = None) -> Array:
        from_arm = np.zeros(6)
        for c, gain, nu in reversed(rows):
            own = nu if beta is None else nu[0] + nu[1:] @ beta
            from_arm = from_arm + (own - gain @ (s + from_arm)) * c
        return from_arm

    return back_substitute


def independent_rows(
    m: Measurement, scale: Array, typical: Array
) -> tuple[list[Scalar], Array, Callable[[Array], Array]]:
    """Return the rows of one arm with a diagonal R, from the factorisation R = L diag(d) L^T.

    The row with the largest remaining pivot comes first. The entries of L are therefore at most one, and the zero
    pivots of an arm with few joints, whose quotients are meaningless, come last.

    Returns:
        A tuple of three. First d >= 0, (rows,). Second, (rows, 10) in the chosen order: L^-1 [C, r], the scale of each
        row, its typical pivot, and the reciprocal of R's part of the scale. With a trunk, its columns follow r; if rows
        have a mask, up to six more columns identify the original row. Third, a function that applies L^-1, in the
        chosen order, to another r, (rows,) or (rows, m).
    """
    width = 1 if m.r.ndim == 1 else m.r.shape[1]
    numbers, inverse_size = 6 + width, 8 + width  # number of columns of L^-1 [C, r]; index of the reciprocal size
    inverse_sizes = array([where(size > 0.0, 1.0 / where(size > 0.0, size, 1.0), 0.0) for size in m.own_sizes()])
    which = [] if m.held is None else [np.eye(len(m.held))]
    R, rows = m.R, np.column_stack([m.C, m.r, scale, typical, inverse_sizes, *which])
    count = len(R)
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
            return d + [0.0] * (count - j), rows, made_independent
        alive = R[j, j] * rows[j, inverse_size] > NEGLIGIBLE_PIVOT
        d.append(where(alive, R[j, j], 0.0))
        below: Array = R[j + 1 :, j] * where(alive, 1.0 / where(alive, R[j, j], 1.0), 0.0)
        rest = R[j + 1 :, j + 1 :] - outer(below, R[j, j + 1 :])
        R = np.concatenate([R[: j + 1], np.hstack([R[j + 1 :, : j + 1], rest])])
        rest_of_row = np.zeros((len(below), rows.shape[1] - numbers))
        less = np.column_stack([outer(below, rows[j, :numbers]), rest_of_row])
        rows = np.concatenate([rows[: j + 1], rows[j + 1 :] - less])
        steps.append((j, exchanges, below))
    return d, rows, made_independent


def exchange(count: int, i: int, j: int) -> list[int]:
    """Return the order of `count` rows with rows i and j exchanged."""
    order = list(range(count))
    order[i], order[j] = j, i
    return order
