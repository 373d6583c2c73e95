"""A rigid grasp in the object's filter: the parallel sum of two mobilities about G."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.measurement import Measurement, Update, of_beta
from holdfast.spatial.linalg import RANK_TOLERANCE, ldl, ldl_solve
from holdfast.spatial.scalar import Array, Scalar
from holdfast.spatial.symmetric import mirrored


def rigid_update(x: Array, P: Array, m: Measurement, size: Array) -> tuple[Array, Array, Update]:
    """Return x, P after a rigidly held arm, and its back-substitution.

    S = P + R,  Gt = S^-1 P,  nu = S^-1 (r - x);  x += P nu,  P = P S^-1 R = Gt^T R: nothing is
    subtracted, and R may be singular (docs/theory/sequential_filter.md). Null pivots of S are dropped. With a trunk
    x and r have its columns behind them.
    """
    S = ldl(P + m.R, m.pivot_sizes(size), RANK_TOLERANCE, m.typical_pivots(size))
    gain = ldl_solve(S, P)
    nu = ldl_solve(S, m.r - x)
    on_trunk = None if nu.ndim == 1 else (m.r - x)[:, 1:].T @ nu
    update = Update(lambda s, beta=None: of_beta(nu, beta) - gain @ s, S.kept, S.weakest, None, on_trunk)
    return x + P @ nu, mirrored(gain.T @ m.R), update


class TerminalUpdate(NamedTuple):
    """The update by the last arm, a rigidly held one, after which only back-substitution is left.

    Attributes:
        answer: beta (c,) of the trunk's columns, or None -> (6,) alpha(G), the external wrench on the object included,
            and (6,) the wrench of the arm on the object, about G.
        nu: S^-1 (r - x), with its columns.
        mobility: (6, 6) P after it.
        kept: how many of its rows are independent of those before.
        weakest: the smallest pivot kept, relative to a typical one.
        on_trunk: (c, 1 + c) [load | inertia] that the arm adds to what the trunk's columns feel, and the load of the
            external wrench through all arms.
    """

    answer: Callable[..., tuple[Array, Array]]
    nu: Array
    mobility: Array
    kept: Scalar
    weakest: Scalar
    on_trunk: Array | None


def terminal_update(x: Array, P: Array, m: Measurement, size: Array, w: Array) -> TerminalUpdate:
    """Return what `rigid_update` and its way back come to at the last arm: two solves instead of seven.

    z = S^-1 P w:  lambda = nu - z,  alpha(G) = x + P nu + R z, as P S^-1 R = R S^-1 P. On a trunk's columns w weighs
    as X^T w does after the arm, X^T w + (E - X)^T z.

    Args:
        x: acceleration of G of the object and the arms before.
        P: their mobility there.
        m: the arm's measurement.
        size: (3,) how mobile P is, for judging pivots.
        w: (6,) external wrench on the object about G.
    """
    S = ldl(P + m.R, m.pivot_sizes(size), RANK_TOLERANCE, m.typical_pivots(size))
    e = m.r - x
    solved = ldl_solve(S, np.column_stack([e, P @ w]))
    z, nu, on_trunk = solved[:, -1], solved[:, 0] if e.ndim == 1 else solved[:, :-1], None
    if e.ndim == 2:
        load = e[:, 1:].T @ (nu[:, 0] - z) - w @ x[:, 1:]
        on_trunk = np.column_stack([load, e[:, 1:].T @ nu[:, 1:]])

    def answer(beta: Array | None = None) -> tuple[Array, Array]:
        free = of_beta(nu, beta)
        return of_beta(x, beta) + P @ free + m.R @ z, free - z

    return TerminalUpdate(answer, nu, mirrored(ldl_solve(S, P).T @ m.R), S.kept, S.weakest, on_trunk)
