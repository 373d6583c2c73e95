"""A rigid grasp in the object's filter: the parallel sum of two mobilities about G."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.measurement import BackSubstitution, Measurement, Update, of_beta
from holdfast.spatial.linalg import RANK_TOLERANCE, back_substitution, halfway, ldl, ldl_solve
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
    v, u = halfway(S, m.r - x)
    nu, on_trunk = back_substitution(S.L, u), None if u.ndim == 1 else v[:, 1:].T @ u

    def again(x: Array, r: Array) -> tuple[Array, BackSubstitution]:
        nu = ldl_solve(S, r - x)
        return x + P @ nu, lambda s, beta=None: of_beta(nu, beta) - gain @ s

    update = Update(lambda s, beta=None: of_beta(nu, beta) - gain @ s, again, S.kept, S.weakest, None, on_trunk)
    return x + P @ nu, mirrored(gain.T @ m.R), update


class TerminalUpdate(NamedTuple):
    """The update by the last arm, a rigidly held one, after which only back-substitution is left.

    Attributes:
        answer: beta (c,) of the trunk's columns, or None -> (6,) alpha(G), the external wrench on the object included,
            and (6,) the wrench of the arm on the object, about G.
        mobility: (6, 6) P after it.
        kept: how many of its rows are independent of those before.
        weakest: the smallest pivot kept, relative to a typical one.
        on_trunk: (c, 1 + c) [load | inertia] that the arm adds to what the trunk's columns feel, and the load of the
            external wrench through all arms.
        again: other x, r and w -> acceleration and wrench, by the factors at hand; in the world.
    """

    answer: Callable[..., tuple[Array, Array]]
    mobility: Array
    kept: Scalar
    weakest: Scalar
    on_trunk: Array | None
    again: Callable[[Array, Array, Array], tuple[Array, Array]]


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
    S, e, on_trunk = ldl(P + m.R, m.pivot_sizes(size), RANK_TOLERANCE, m.typical_pivots(size)), m.r - x, None
    (v, u), (_, under_w) = halfway(S, e), halfway(S, P @ w)
    if e.ndim == 2:
        load = v[:, 1:].T @ (u[:, 0] - under_w) - w @ x[:, 1:]
        on_trunk = np.column_stack([load, v[:, 1:].T @ u[:, 1:]])

    def answer(beta: Array | None = None) -> tuple[Array, Array]:
        nu, z = back_substitution(S.L, np.column_stack([of_beta(u, beta), under_w])).T
        return of_beta(x, beta) + P @ nu + m.R @ z, nu - z

    def again(x: Array, r: Array, w: Array) -> tuple[Array, Array]:
        nu, z = ldl_solve(S, np.column_stack([r - x, P @ w])).T
        return x + P @ nu + m.R @ z, nu - z

    return TerminalUpdate(answer, mirrored(ldl_solve(S, P).T @ m.R), S.kept, S.weakest, on_trunk, again)
