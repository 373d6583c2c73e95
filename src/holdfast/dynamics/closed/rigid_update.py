"""A rigid grasp in the object's filter: the parallel sum of two mobilities about G."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.measurement import BackSubstitution, Measurement, Update, of_beta
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

    def again(x: Array, r: Array) -> tuple[Array, BackSubstitution]:
        nu = ldl_solve(S, r - x)
        return x + P @ nu, lambda s, beta=None: of_beta(nu, beta) - gain @ s

    update = Update(lambda s, beta=None: of_beta(nu, beta) - gain @ s, S.kept, S.weakest, None, on_trunk, again)
    return x + P @ nu, mirrored(gain.T @ m.R), update


class TerminalUpdate(NamedTuple):
    """The update by the last arm, a rigidly held one, after which only back-substitution is left.

    Attributes:
        acceleration: (6,) alpha(G), the external wrench on the object included.
        wrench: (6,) of the arm on the object, about G.
        mobility: (6, 6) P after it.
        kept: how many of its rows are independent of those before.
        weakest: the smallest pivot kept, relative to a typical one.
        again: other x, r and w -> acceleration and wrench, by the factors at hand.
    """

    acceleration: Array
    wrench: Array
    mobility: Array
    kept: Scalar
    weakest: Scalar
    again: Callable[[Array, Array, Array], tuple[Array, Array]]


def terminal_update(x: Array, P: Array, m: Measurement, size: Array, w: Array) -> TerminalUpdate:
    """Return what `rigid_update` and its way back come to at the last arm: two solves instead of seven.

    z = S^-1 P w:  lambda = nu - z,  alpha(G) = x + P nu + R z, as P S^-1 R = R S^-1 P.

    Args:
        x: acceleration of G of the object and the arms before.
        P: their mobility there.
        m: the arm's measurement.
        size: (3,) how mobile P is, for judging pivots.
        w: (6,) external wrench on the object about G.
    """
    S = ldl(P + m.R, m.pivot_sizes(size), RANK_TOLERANCE, m.typical_pivots(size))

    def solve(x: Array, r: Array, w: Array) -> tuple[Array, Array]:
        nu, z = ldl_solve(S, np.column_stack([r - x, P @ w])).T
        return x + P @ nu + m.R @ z, nu - z

    acceleration, wrench = solve(x, m.r, w)
    return TerminalUpdate(acceleration, wrench, mirrored(ldl_solve(S, P).T @ m.R), S.kept, S.weakest, solve)
