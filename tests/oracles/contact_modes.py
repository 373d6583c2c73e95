"""All motions that Signorini's and Coulomb's laws allow at some contacts, by trying every mode: the oracle.

Every contact is open, sticks, or slips in an unknown direction theta (or a known one, or without friction). With
P = L L^T, B = C L and z = sum B_j^T lambda_j, the sticking contacts leave z = z_S + Z y, Z a basis of the null space
of their rows, and y is the sum of what slipping ones press, Z^T (n - mu t(theta)) lambda_n. Normal velocities of zero
give lambda_n(theta), and the slip has the direction theta where t x u_t = 0, t . u_t > 0: Newton's method from a dense
grid of directions. Forces of sticking contacts that are not unique are a feasibility problem of cones (Clarabel).

Several motions with slips whose normal rows depend on each other, such as those of a table, are not looked for.
"""

from __future__ import annotations

from importlib import import_module
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse

DIRECTIONS = {0: 1, 1: 720, 2: 48, 3: 14}  # tried, of each slip, for so many slips
SMALL = 1e-9  # violation, relative to the largest free velocity, that is rounding
Array = np.ndarray


class Motion(NamedTuple):
    """One motion that satisfies the laws.

    Attributes:
        modes: one letter for every contact: o(pen), s(ticks), x (slips, or closed without friction).
        change: (6,) P w, of the object's velocity or acceleration.
        margin: distance of the nearest other mode, relative to the largest free velocity.
        forces: (k, 3) in contact axes [t1, t2, n]; of sticking contacts NaN where they are not unique.
        wrench: (6,) w; the smallest one if the mobility is singular.
    """

    modes: str
    change: Array
    margin: float
    forces: Array
    wrench: Array


def all_motions(P: Array, C: Array, b: Array, mu: Array, slide: Array | None = None) -> list[Motion]:
    """Return all motions, those first whose margins are largest.

    Args:
        P: (6, 6) mobility.
        C: (k, 3, 6) rows of contact velocities, axes [t1, t2, n].
        b: (k, 3) velocities without contact forces.
        mu: (k,) friction.
        slide: (k, 2) unit directions of contacts that slide already (b are accelerations), 0 for others.
    """
    k = len(mu)
    values, vectors = np.linalg.eigh(P)
    kept = values > 1e-11 * values.max()
    L = vectors[:, kept] * np.sqrt(values[kept])
    slide = np.zeros((k, 2)) if slide is None else slide
    known = (mu == 0.0) | slide.any(axis=1)
    found: list[Motion] = []
    for modes in product(*("ox" if one else "osx" for one in known)):
        for one in _of_modes("".join(modes), C @ L, b, mu, slide, known):
            change = L @ one.change
            if all(np.abs(C @ (change - m.change)).max() > 1e-6 * np.abs(b).max() for m in found):
                found.append(one._replace(change=change, wrench=np.linalg.pinv(P, rcond=1e-11) @ change))
    return sorted(found, key=lambda one: -one.margin)


def _of_modes(modes: str, B: Array, b: Array, mu: Array, slide: Array, known: Array) -> list[Motion]:
    """Return the motions of one choice of modes, with z as their change."""
    S, T = ([j for j, one in enumerate(modes) if one == letter] for letter in "sx")
    turning = [i for i, j in enumerate(T) if not known[j]]
    r, size = B.shape[2], np.abs(b).max()
    z_S, Z, held = np.zeros(r), np.eye(r), np.zeros((r, 0))
    if S:
        rows = B[S].reshape(-1, r)
        U, s, Vt = np.linalg.svd(rows)
        rank = int((s > 1e-9 * s[0]).sum())
        z_S = -Vt[:rank].T @ ((U[:, :rank].T @ b[S].ravel()) / s[:rank])
        if np.abs(rows @ z_S + b[S].ravel()).max() > SMALL * size:
            return []
        held, Z = Vt[:rank].T, Vt[rank:].T
    if len(T) > Z.shape[1]:
        return []
    ways = DIRECTIONS.get(len(turning), 8)
    grid = np.arange(ways) * (2.0 * np.pi / ways) + 0.1
    theta = np.array(list(product(grid, repeat=len(turning)))).reshape(ways ** len(turning), len(turning))

    def at(theta: Array) -> tuple[Array, Array, Array, Array]:
        """Return normal forces (m, T), directions (m, T, 2), z (m, r) and what must vanish (m, turning)."""
        t = np.broadcast_to(slide[T], (len(theta), len(T), 2)).copy()
        t[:, turning] = np.stack([np.cos(theta), np.sin(theta)], axis=-1)
        N = B[T, 2] - mu[T, None] * np.einsum("mtc,tcr->mtr", t, B[T][:, :2])
        NZ = N @ Z
        A = np.einsum("is,mjs->mij", B[T, 2] @ Z, NZ)
        right = -(b[T, 2] + B[T, 2] @ z_S)
        with np.errstate(all="ignore"):
            try:
                x = np.linalg.solve(A, np.broadcast_to(right[:, None], (len(theta), len(T), 1)))[..., 0]
            except np.linalg.LinAlgError:
                x = np.einsum("mij,j->mi", np.linalg.pinv(A), right)
        z = z_S + np.einsum("mj,mjs->ms", x, NZ) @ Z.T
        w = np.array(T, int)[turning]
        u = b[w, :2] + np.einsum("tcr,mr->mtc", B[w, :2], z)
        tt = t[:, turning]
        whole = np.linalg.det(A)[:, None]  # without it the equations have poles between their zeros
        return x, t, z, whole * (tt[..., 0] * u[..., 1] - tt[..., 1] * u[..., 0])

    if turning:
        theta = _zeros(lambda one: at(one)[3], theta)
        if not len(theta):
            return []
    x, t, z, _ = at(theta)
    found = []
    for one in range(len(theta)):
        motion = _checked(modes, S, T, x[one], t[one], z[one], held, B, b, mu, known)
        if motion is not None:
            found.append(motion)
    return found


def _zeros(f: Any, theta: Array) -> Array:
    """Return the distinct zeros of a function of angles (m, s) that Newton's method finds from all starts."""
    s, d = theta.shape[1], 1e-7
    with np.errstate(all="ignore"):
        for rounds in (8, 6, 12):
            for _ in range(rounds):
                now = f(theta)
                J = np.stack([(f(theta + d * e) - f(theta - d * e)) / (2 * d) for e in np.eye(s)], axis=-1)
                J = np.where(np.isfinite(J), J, 0.0) + 1e-300 * np.eye(s)
                step = np.linalg.solve(J, np.where(np.isfinite(now), now, 0.0)[..., None])[..., 0]
                length = np.linalg.norm(step, axis=1, keepdims=True)
                theta = theta - step * np.minimum(1.0, 0.3 / np.maximum(length, 1e-300))
            theta = _distinct(theta[np.isfinite(theta).all(axis=1)], 3 if rounds < 12 else 6)
            if not len(theta):
                return theta
    return theta[np.isfinite(f(theta)).all(axis=1)]  # `_checked` asks whether they are zeros


def _distinct(theta: Array, digits: int) -> Array:
    """Return those of some angles (m, s) that differ in their first digits."""
    turned = np.round(np.concatenate([np.cos(theta), np.sin(theta)], axis=1), digits)
    return theta[np.unique(turned, axis=0, return_index=True)[1]]


def _checked(
    modes: str,
    S: list[int],
    T: list[int],
    x: Array,
    t: Array,
    z: Array,
    held: Array,
    B: Array,
    b: Array,
    mu: Array,
    known: Array,
) -> Motion | None:
    """Return the motion if all inequalities of its modes hold."""
    size = np.abs(b).max()
    gauge = (B * B).sum(axis=(1, 2)) / 3.0
    u = b + B @ z
    margins = [u[j, 2] / size for j, one in enumerate(modes) if one == "o"]
    forces = np.zeros(b.shape)
    for j, force, direction in zip(T, x, t, strict=True):
        forces[j] = force * np.append(-mu[j] * direction, 1.0)
        margins.append(force * gauge[j] / size)
        if not known[j]:
            margins.append(float(direction @ u[j, :2]) / size)
            if abs(direction[0] * u[j, 1] - direction[1] * u[j, 0]) > 1e-8 * size:
                return None
    if not np.isfinite(z).all() or min(margins, default=1.0) < 0.0:
        return None
    if S:
        slack, own = _in_cones(B[S], mu[S], held @ (held.T @ (z - np.einsum("j,jr->r", x, _along(B[T], mu[T], t)))))
        forces[S] = own
        margins.append(slack * float(gauge[S].max()) / size)
    return None if min(margins, default=1.0) < 0.0 else Motion(modes, z, min(margins, default=1.0), forces, z)


def _along(B: Array, mu: Array, t: Array) -> Array:
    return B[:, 2] - mu[:, None] * np.einsum("tc,tcr->tr", t, B[:, :2])


def _in_cones(B: Array, mu: Array, push: Array) -> tuple[float, Array]:
    """Return the largest slack mu n - |t| >= slack of forces with sum B^T lambda = push, at most |push|, and forces."""
    rows = B.reshape(-1, B.shape[2]).T
    s = np.linalg.svd(rows, compute_uv=False)
    count = 3 * len(B)
    if len(s) >= count and s[count - 1] > 1e-9 * s[0]:
        own = np.linalg.lstsq(rows, push, rcond=None)[0].reshape(-1, 3)
        return float((mu * own[:, 2] - np.hypot(own[:, 0], own[:, 1])).min()), own
    clarabel: Any = import_module("clarabel")
    unit = float(np.linalg.norm(push)) / float(np.linalg.norm(rows, 2)) + 1e-300
    U, s, Vt = np.linalg.svd(rows, full_matrices=False)
    rank = int((s > 1e-9 * s[0]).sum())
    E = np.hstack([Vt[:rank], np.zeros((rank, 1))])
    e = (U[:, :rank].T @ push) / s[:rank] / unit
    G, h, cones = [E, np.eye(1, count + 1, count)], [e, [1.0]], [clarabel.ZeroConeT(rank), clarabel.NonnegativeConeT(1)]
    for j in range(len(B)):
        block = np.zeros((3, count + 1))
        block[0, 3 * j + 2], block[0, count] = -mu[j], 1.0
        block[1, 3 * j] = block[2, 3 * j + 1] = -1.0
        G.append(block)
        h.append(np.zeros(3))
        cones.append(clarabel.SecondOrderConeT(3))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-10
    q = np.append(np.zeros(count), -1.0)
    csc = scipy.sparse.csc_matrix
    done = clarabel.DefaultSolver(
        csc((count + 1, count + 1)), q, csc(np.vstack(G)), np.concatenate(h), cones, settings
    ).solve()
    if str(done.status) not in ("Solved", "AlmostSolved"):
        return -np.inf, np.full((len(B), 3), np.nan)
    return float(done.x[count]) * unit, np.full((len(B), 3), np.nan)
