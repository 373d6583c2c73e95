"""The update of the object's filter by a rigid grasp: the parallel sum of two mobilities about G."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from holdfast.dynamics.closed.measurement import BackSubstitution, Measurement, Update, of_beta
from holdfast.spatial.linalg import RANK_TOLERANCE, back_substitution, halfway, ldl, ldl_solve
from holdfast.spatial.scalar import Array, Scalar
from holdfast.spatial.symmetric import mirrored


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
