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

from typing import NamedTuple

import numpy as np

from holdfast.spatial.scalar import Array

MOST_SHARE_STEPS = 30
CONES = (0.8, 0.95, 0.99, 0.999, 1.0 - 1e-9)  # of the friction that a share may use
WEIGHTS = (1e-2, 1e-2, 1e-2, 1e-2, 0.0)  # of the change of a share, which makes it unique and a continuous function
LEAST_BORNE = 0.1  # of the mean normal force and of what is left of friction: its share is at least that
NO_LOAD = 1e-11  # singular values below this part of the largest: forces without an effect
NO_CURVATURE = 1e-6  # relative: along such directions rounding of the slope would move the forces
HOLDS = 1e-12  # distance from the cones, relative to the forces


class FrictionCones(NamedTuple):
    """The rows of several contacts, as cones of which the first axis is the normal.

    Attributes:
        rows: (k, 3 or 4) of each contact, the normal first; m, beyond the last one, where it has fewer in its cone.
        friction: (k,) mu.
    """

    rows: Array
    friction: Array

    @classmethod
    def of(cls, of: Array, friction: Array, sticks: Array) -> FrictionCones:
        """Return those of `within_cones`."""
        owners, found = np.unique(of), []
        for j in owners.tolist():
            own = np.flatnonzero(of == j).tolist()
            normal = own.pop(2 if sticks[j] else 0)
            found.append([normal, *(own if sticks[j] and friction[j] > 0.0 else [])])
        longest = max(map(len, found), default=1)
        rows = [[*own, *[len(of)] * (longest - len(own))] for own in found]
        return cls(np.array(rows, dtype=int).reshape(len(found), longest), friction[owners])

    def parts(self, x: Array) -> Array:
        """Return rows (s, m, ...) by contact, (s, k, 3 or 4, ...)."""
        return np.concatenate([x, np.zeros_like(x[:, :1])], axis=1)[:, self.rows]

    def scales(self, part: float) -> Array:
        """Return factors (k, 3 or 4) of forces that turn cones of a part of the friction into unit cones."""
        found = np.ones(self.rows.shape)
        rough = self.friction > 0.0
        found[rough, 1:] = 1.0 / (part * self.friction[rough, None])
        return found


def within_cones(of: Array, D: Array, friction: Array, sticks: Array, x: Array) -> Array:
    """Return forces in the imposed rows with the same effect that lie in the cones, or are nearest to them.

    All but the contacts' modes may have a leading axis, and each entry of it is solved by itself.

    Args:
        of: (m,) contact of each row; the rows of one follow each other.
        D: (m, r) what a unit of each force exerts.
        friction: (k,) mu.
        sticks: (k,) which contacts stick: their rows are the three axes, of others the first one is the normal.
        x: (m,) forces.
    """
    if x.ndim == 1:
        return within_cones(of, D[None], friction, sticks, x[None])[0]
    cones, found = FrictionCones.of(of, friction, sticks), x.copy()
    inside = _off(_in_unit_cones(cones, x, x, CONES[0]))[0] == 0.0
    if inside.all():
        return found
    left = np.flatnonzero(~inside)
    _, s, Vt = np.linalg.svd(D[left].swapaxes(1, 2))
    ranks = (s > NO_LOAD * s.max(axis=1, initial=0.0, keepdims=True)).sum(axis=1)
    for rank in np.unique(ranks[ranks < x.shape[1]]).tolist():
        here = ranks == rank
        found[left[here]] = _shared(cones, x[left[here]], Vt[here, rank:].swapaxes(1, 2))
    return found


def _shared(cones: FrictionCones, x: Array, N: Array) -> Array:
    """Return forces x + N c in the narrowest cones near which some c makes them hold, (s, m)."""
    found, left = x.copy(), np.arange(len(x))
    for part, wider, weight in zip(CONES, (*CONES[1:], CONES[-1]), WEIGHTS, strict=True):
        y = _in_unit_cones(cones, x[left], x[left], part)
        outside = _off(y)[0] > 0.0
        found[left[~outside]] = x[left[~outside]]
        left, y = left[outside], y[outside]
        moves = cones.scales(part)[..., None] * cones.parts(N[left])
        c = _nearest(y, moves, weight)
        found[left] = x[left] + (N[left] @ c[..., None])[..., 0]
        if weight:
            left = left[_off(_in_unit_cones(cones, found[left], x[left], wider))[0] > 0.0]
        if not len(left):
            break
    return found


def _in_unit_cones(cones: FrictionCones, x: Array, loads: Array, part: float) -> Array:
    """Return forces x (s, m) as those of unit cones, (s, k, 3 or 4), if their cones use a part of the friction.

    Args:
        cones: the cones.
        x: (s, m) forces.
        loads: (s, m) forces whose mean normal force tells how much every contact has to bear.
        part: of the friction.
    """
    y = cones.scales(part) * cones.parts(x)
    y[..., 0] -= LEAST_BORNE * (1.0 - part) * np.abs(cones.parts(loads)[..., 0]).mean(axis=1, keepdims=True)
    return y


def _nearest(y: Array, moves: Array, weight: float) -> Array:
    """Return for which c (s, c) forces y + moves c are nearest to unit cones, with c of least norm by a weight."""
    s, count = len(y), moves.shape[-1]
    flat, size = moves.reshape(s, -1, count), np.abs(y).max(axis=(1, 2))
    c = np.zeros((s, count))
    off, slope, bend = _off(y)
    value, left = off.copy(), np.arange(s)
    for _ in range(MOST_SHARE_STEPS):
        left = left[np.sqrt(off[left]) > HOLDS * size[left]]
        if not len(left):
            break
        M, now = flat[left], c[left]
        H = M.swapaxes(1, 2) @ (bend[left] @ moves[left]).reshape(M.shape) + weight * np.eye(count)
        g = (slope[left].reshape(len(left), 1, -1) @ M)[:, 0] + weight * now
        step, taken = _newton_step(H, g), np.zeros(len(left), dtype=bool)
        for part in (1.0, 0.5, 0.25, 0.1, 0.01):
            (rest,) = np.nonzero(~taken)
            if not len(rest):
                break
            at = now[rest] + part * step[rest]
            tried = _off(y[left[rest]] + (M[rest] @ at[..., None]).reshape(len(rest), *y.shape[1:]))
            later = tried[0] + 0.5 * weight * (at * at).sum(axis=1)
            good = later < value[left[rest]]
            into = left[rest[good]]
            c[into], value[into] = at[good], later[good]
            for kept, new in zip((off, slope, bend), tried, strict=True):
                kept[into] = new[good]
            taken[rest[good]] = True
        left = left[taken]
    return c


def _newton_step(H: Array, g: Array) -> Array:
    """Return the shortest -H^+ g, (s, c), without what has no curvature."""
    bends, V = np.linalg.eigh(H)
    curved = bends > NO_CURVATURE * bends[:, -1:]
    along = (g[:, None] @ V)[:, 0] / np.where(curved, bends, 1.0)
    return -(V @ np.where(curved, along, 0.0)[..., None])[..., 0]


def _off(y: Array) -> tuple[Array, Array, Array]:
    """Return half the squared distance of forces (s, k, 3 or 4) from unit cones, its gradient and its Hessians."""
    n, t = y[..., 0], y[..., 1:]
    size = np.sqrt((t * t).sum(axis=-1))
    inside, below = size <= n, size <= -n
    between = ~inside & ~below
    d = t / np.where(size > 0.0, size, 1.0)[..., None]
    gap, ratio = 0.5 * np.where(between, size - n, 0.0), (n / np.where(between, size, 1.0))[..., None, None]
    slope = (
        np.concatenate([-gap[..., None], gap[..., None] * d], axis=-1)
        + np.where(below & ~inside, 1.0, 0.0)[..., None] * y
    )
    whole = np.eye(y.shape[-1])
    block = np.empty((*y.shape, y.shape[-1]))
    block[..., 0, 0] = 1.0
    block[..., 0, 1:] = block[..., 1:, 0] = -d
    block[..., 1:, 1:] = (1.0 - ratio) * whole[1:, 1:] + ratio * d[..., :, None] * d[..., None, :]
    bend = np.where(between[..., None, None], 0.5 * block, np.where((below & ~inside)[..., None, None], whole, 0.0))
    return 0.5 * (slope * slope).sum(axis=(1, 2)), slope, bend
