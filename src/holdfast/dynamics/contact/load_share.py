"""How redundant contacts share a load: as equal compliances do, or, where that leaves the cones, in a way that holds.

The forces of contacts in fixed modes are y = y_0 + N c, where the columns of N change no motion. Those nearest to the
cones minimise sum |y_j - P_j(y_j)|^2 / 2, P_j the projection of contact j onto its cone: a convex function of c, with
the gradient N^T (y - P(y)) and the generalised Hessian N^T (1 - dP) N. It is zero if and only if a share holds.
Where none does, forces leave their cones continuously, so that the instant can be located.

Reference: J. F. Bonnans and H. Ramirez C., Perturbation analysis of second-order cone programming problems, 2005.
"""

from __future__ import annotations

import numpy as np

from holdfast.spatial.scalar import Array

MOST_SHARE_STEPS = 30
OF_FRICTION = 1.0 - 1e-9  # of the friction that a share may use
NO_LOAD = 1e-11  # singular values below this part of the largest: forces without an effect
HOLDS = 1e-12  # distance from the cones, relative to the forces


def within_cones(of: Array, D: Array, friction: Array, sticks: Array, x: Array) -> Array:
    """Return forces in the imposed rows with the same effect that lie in the cones, or are nearest to them.

    Args:
        of: (m,) contact of each row; the rows of one follow each other.
        D: (m, r) what a unit of each force exerts.
        friction: (k,) mu.
        sticks: (k,) which contacts stick: their rows are the three axes, of others the first one is the normal.
        x: (m,) forces.
    """
    scale = np.ones(len(x))
    cones = []
    for j in np.unique(of).tolist():
        rows = np.flatnonzero(of == j)
        normal = rows[2] if sticks[j] else rows[0]
        tangents = np.setdiff1d(rows, normal) if sticks[j] and friction[j] > 0.0 else rows[:0]
        scale[tangents] = 1.0 / (OF_FRICTION * friction[j]) if len(tangents) else 1.0
        cones.append(np.concatenate([[normal], tangents]))
    y = scale * x
    off, slope, bend = _off(cones, y)
    if off == 0.0:
        return x
    _, s, Vt = np.linalg.svd(D.T)
    N = Vt[int((s > NO_LOAD * s.max(initial=0.0)).sum()) :].T
    if not N.shape[1]:
        return x
    moves, size = scale[:, None] * N, float(np.abs(y).max())
    for _ in range(MOST_SHARE_STEPS):
        if np.sqrt(off) <= HOLDS * size:
            break
        H = moves.T @ bend @ moves
        step = moves @ np.linalg.solve(H + 1e-12 * (1.0 + np.trace(H)) * np.eye(len(H)), -(moves.T @ slope))
        for part in (1.0, 0.5, 0.25, 0.1, 0.01):
            tried = _off(cones, y + part * step)
            if tried[0] < off:
                break
        else:
            break
        y, (off, slope, bend) = y + part * step, tried
    return y / scale


def _off(cones: list[Array], y: Array) -> tuple[float, Array, Array]:
    """Return half the squared distance of scaled forces from unit cones, its gradient and its Hessian."""
    slope, bend = np.zeros(len(y)), np.zeros((len(y), len(y)))
    for rows in cones:
        n, t = y[rows[0]], y[rows[1:]]
        size = float(np.linalg.norm(t))
        if size <= n:
            continue
        if size <= -n:
            slope[rows], bend[np.ix_(rows, rows)] = y[rows], np.eye(len(rows))
            continue
        d = t / size
        slope[rows] = 0.5 * (size - n) * np.concatenate([[-1.0], d])
        block = np.eye(len(rows))
        block[0] = block[:, 0] = np.concatenate([[1.0], -d])
        block[1:, 1:] = (1.0 - n / size) * np.eye(len(t)) + n / size * np.outer(d, d)
        bend[np.ix_(rows, rows)] = 0.5 * block
    return 0.5 * float(slope @ slope), slope, bend
