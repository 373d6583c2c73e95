"""How the smallest forces of a forest change where forces are not unique.

With the metric S of forces, S lambda = G mu. At constant rank, with N a basis of ker G^T, N^T S N = 1,

    d lambda = (1 - N N^T S) d lambda_any + N N^T d(G mu - S lambda),     mu and lambda held on the right,

of any solution's d lambda_any; a cotangent lambda_bar is equivalent to lambda_bar - S v of any solution's forces and a
virtual power v.(G mu - S lambda) with v = N N^T lambda_bar (docs/theory/derivatives.md).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.stacked import block_diagonal
from holdfast.dynamics.tree.forest_motion import ForestMotion
from holdfast.dynamics.tree.forest_rows import force_metric, forest_rows, weighed_rows
from holdfast.dynamics.tree.virtual_power import ForestUnknowns, along_rows, carried, unknowns_from
from holdfast.spatial.scalar import Array, array, concatenate


class LeastForceRates(NamedTuple):
    """The smallest forces, in the layout of the forces in `ForestUnknowns.flat`.

    Attributes:
        N: (rows, k) basis of the forces without effect, N^T S N = 1.
        S: (rows, rows) the metric.
        mu: per body, (m,) with S lambda = G mu.
    """

    N: Array
    S: Array
    mu: list[Array]

    def residual(self, motion: ForestMotion, z: ForestUnknowns) -> Array:
        """Return G mu - S lambda for a motion whose numbers may vary, (rows,)."""
        metric, (closed, coupled) = force_metric(motion), along_rows(motion, self.mu, carried(motion, self.mu))
        closures = zip(motion.closures, closed, z.closures, strict=True)
        parts = [moved - c.K @ (metric.weights * (f @ c.K)) for c, moved, f in closures if len(c.K)]
        couplings = zip(coupled, metric.couplings, z.couplings, strict=True)
        return concatenate([*parts, array([moved - weight * x for moved, weight, x in couplings])])

    def split(self, z_bar: Array) -> tuple[Array, Array]:
        """Return v, (rows,), and the equivalent cotangent of any solution."""
        n = len(z_bar) - len(self.S)
        v = self.N @ (self.N.T @ z_bar[n:])
        return v, np.concatenate([z_bar[:n], z_bar[n:] - self.S @ v])

    def smallest(self, moved: Array, changed: Array) -> Array:
        """Return the rates of the unknowns with the smallest forces, from any solution's (.., d) and `residual`'s."""
        n = len(moved) - len(self.S)
        return np.concatenate([moved[:n], moved[n:] + self.N @ (self.N.T @ (changed - self.S @ moved[n:]))])


def least_force_rates(motion: ForestMotion, z: ForestUnknowns, rank: int) -> LeastForceRates:
    """Return how the smallest forces of a solution change, O(n^3).

    Args:
        motion: the forest's motion.
        z: the solution, with the smallest forces.
        rank: rank of the constraint.
    """
    weighed = weighed_rows(motion, forest_rows(motion))
    C = block_diagonal(weighed.factors)
    U, s, Vt = np.linalg.svd(weighed.E)
    force = concatenate([*z.closures, z.couplings])
    mu = Vt[:rank].T @ ((U[:, :rank].T @ (C.T @ force)) / s[:rank])
    N = np.linalg.solve(C.T, U[:, rank:])
    return LeastForceRates(N, C @ C.T, unknowns_from(motion, np.concatenate([mu, 0.0 * force])).rates)
