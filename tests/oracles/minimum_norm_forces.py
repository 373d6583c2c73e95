"""Where forces are not unique: the least ones, and derivatives along motions that keep the grasps closed.

Accelerations are unique still, and the equations have solutions along every motion that the grasps allow. With B f what
joints and object feel of the forces, W the metric and N a basis of the forces that nobody feels, N^T W N = 1,

    f = f_any - N N^T W f_any = W^-1 B^T mu,     df = P df_any + N N^T (dB^T) mu,     P = 1 - N N^T W

where df_any solves the equations' slopes at the least f (Golub and Pereyra at constant rank).
"""

from __future__ import annotations

import numpy as np

from tests.oracles.arithmetic import arithmetic
from tests.oracles.chain_derivatives import Along, Derivatives, Equations
from tests.systems.as_chain import Problem

STATE = ("q", "object_pose", "qd", "object_twist")
CUTOFF = 1e-10  # singular values below this share of the largest count as 0


def minimum_norm_derivatives(p: Problem, tangent: np.ndarray) -> Derivatives:
    """Return forward dynamics with the least sum of |m/L|^2 + |f|^2, and its derivatives along motions.

    Args:
        p: the problem; L is the contact points' rms distance from their centroid.
        tangent: (2n + 12, m) columns (dq, turn, shift, dqd, d omega, dv) that keep positions and rates closed.

    Returns:
        Its matrices are along the tangent, all of them one block by the name of "tangent".
    """
    equations = Equations(p, arithmetic(None), STATE)
    at, K = equations.at, equations.K
    others = np.setdiff1d(np.arange(at.size), np.arange(at.f.start, at.f.stop))
    B, w = K[others, at.f], metric(p)
    basis = null_space(B / np.sqrt(w)) / np.sqrt(w)[:, None]  # N^T W N = 1

    def least(f: np.ndarray) -> np.ndarray:
        return f - basis @ (basis.T @ (w * f.T).T)

    z = np.linalg.lstsq(K, equations.rhs, rcond=CUTOFF)[0]
    z[at.f] = least(z[at.f])
    mu = np.zeros(at.size)
    mu[others] = np.linalg.lstsq(B.T, w * z[at.f], rcond=CUTOFF)[0]
    of_z, none = equations.along(z), np.zeros(at.size)
    turned = (equations.along(mu).slopes - equations.along(none).slopes)[at.f] @ tangent
    dz = np.linalg.lstsq(K, -of_z.slopes @ tangent, rcond=CUTOFF)[0]
    dz[at.f] = least(dz[at.f]) + basis @ (basis.T @ turned)
    along = Along(of_z.slopes @ tangent, of_z.of_bases @ tangent, of_z.bases)
    equations.seeded.at.clear()
    equations.seeded.at["tangent"] = slice(0, tangent.shape[1])
    return equations.named(z, dz, along)


def metric(p: Problem) -> np.ndarray:
    """Return W, (6 g,): 1/L^2 of moments, 1 of forces."""
    points = np.array([p.state.object_frame.R @ grasp.frame.p for grasp in p.chain.grasps.values()])
    length = np.sqrt(((points - points.mean(0)) ** 2).sum(1).mean())
    return np.tile(np.repeat([length**-2.0, 1.0], 3), len(points))


def null_space(B: np.ndarray) -> np.ndarray:
    """Return orthonormal columns that a matrix takes to zero."""
    _, values, rows = np.linalg.svd(B)
    return rows[(values > CUTOFF * values[0]).sum() :].T
