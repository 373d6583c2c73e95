"""How redundant contacts share a load: as equal compliances do, or, where that nears the cones, in a way that holds.

The forces of contacts in fixed modes are y = y_0 + N c, where the columns of N change no motion. Those nearest to the
cones minimise sum |y_j - P_j(y_j)|^2 / 2, P_j the projection of contact j onto its cone: a convex function of c, with
the gradient N^T (y - P(y)) and the generalised Hessian N^T (1 - dP) N. It is zero if and only if a share holds.
Where none does, forces leave their cones continuously, so that the instant can be located.

On the border of its own cone, rounding would decide whether a contact slips. Narrower cones come first, with a weight
on |c|^2 that makes the share unique, and the narrowest near which one holds is taken.

Reference: J. F. Bonnans and H. Ramirez C., Perturbation analysis of second-order cone programming problems, 2005.
"""

from __future__ import annotations

import numpy as np

from holdfast.spatial.scalar import Array

MOST_SHARE_STEPS = 30
CONES = (0.8, 0.95, 0.99, 0.999, 1.0 - 1e-9)  # of the friction that a share may use
WEIGHTS = (1e-2, 1e-2, 1e-2, 1e-2, 0.0)  # of the change of a share, which makes it unique and a continuous function
LEAST_BORNE = 0.1  # of the mean normal force and of what is left of friction: its share is at least that
NO_LOAD = 1e-11  # singular values below this part of the largest: forces without an effect
NO_CURVATURE = 1e-6  # relative: along such directions rounding of the slope would move the forces
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
    normals, tangents = [], []
    for j in np.unique(of).tolist():
        rows = np.flatnonzero(of == j)
        normals.append(rows[2] if sticks[j] else rows[0])
        tangents.append(np.setdiff1d(rows, normals[-1]) if sticks[j] and friction[j] > 0.0 else rows[:0])
    cones = [np.concatenate([[n], t]) for n, t in zip(normals, tangents, strict=True)]
    scale, apex, mean = np.ones(len(x)), np.zeros(len(x)), np.abs(x[normals]).mean() if normals else 0.0
    N, found = None, x
    for part, wider, weight in zip(CONES, (*CONES[1:], CONES[-1]), WEIGHTS, strict=True):
        for n, t in zip(normals, tangents, strict=True):
            scale[t] = 1.0 / (part * friction[of[n]]) if len(t) else 1.0
        apex[normals] = LEAST_BORNE * (1.0 - part) * mean
        y = scale * x - apex
        if _off(cones, y)[0] == 0.0:
            return x
        if N is None:
            _, s, Vt = np.linalg.svd(D.T)
            N = Vt[int((s > NO_LOAD * s.max(initial=0.0)).sum()) :].T
        if not N.shape[1]:
            return x
        found = (_nearest(cones, y, scale[:, None] * N, weight) + apex) / scale
        for n, t in zip(normals, tangents, strict=True):
            scale[t] = 1.0 / (wider * friction[of[n]]) if len(t) else 1.0
        apex[normals] = LEAST_BORNE * (1.0 - wider) * mean
        if weight and _off(cones, scale * found - apex)[0] == 0.0:
            break
    return found


def _nearest(cones: list[Array], y: Array, moves: Array, weight: float) -> Array:
    """Return scaled forces y + moves c nearest to unit cones, with c of least norm by a weight."""
    c, size = np.zeros(moves.shape[1]), float(np.abs(y).max())
    off, slope, bend = _off(cones, y)
    value = off
    for _ in range(MOST_SHARE_STEPS):
        if np.sqrt(off) <= HOLDS * size:
            break
        H = moves.T @ bend @ moves + weight * np.eye(len(c))
        step = np.linalg.lstsq(H, -(moves.T @ slope + weight * c), rcond=NO_CURVATURE)[0]
        for part in (1.0, 0.5, 0.25, 0.1, 0.01):
            tried = _off(cones, y + moves @ (c + part * step))
            if (later := tried[0] + 0.5 * weight * float((c + part * step) @ (c + part * step))) < value:
                break
        else:
            break
        c, value, (off, slope, bend) = c + part * step, later, tried
    return y + moves @ c


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
