"""The step in which the root of a part moves inward over a joint, while only free bodies are open.

Everything that has been measured hangs on body k, whose inertia I(k) includes N by now, and whose load z(k) includes n.
With W = X H, the open accelerations x + X beta(k) + P s become functions of the parent's (docs/theory/trunk.md):

    P += W D^-1 W^T,   x += W nu,   X <- (X - W G^T) phi^T
    qdd = nu + D^-1 W^T s - G^T phi^T beta(p),   beta(k) = phi^T beta(p) + H qdd

A free body is crossed likewise, with H = 1 and D = I(k); nothing moves it from the world. If the columns are the rates
of fewer than six joints between the root and the world, all are crossed together: D is their mass matrix, G = 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import reduce
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.tip_response import LEAST_INERTIA
from holdfast.dynamics.tree.belief import Belief
from holdfast.dynamics.tree.forest_motion import BodyMotion
from holdfast.dynamics.tree.settled import SettledBody
from holdfast.dynamics.tree.steps import Back, Inward
from holdfast.model.forest import GROUND
from holdfast.spatial.linalg import MaskedLDL, forward_substitution, ldl, ldl_solve
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, maximum, where
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench
from holdfast.spatial.symmetric import Symmetric6, mirrored
from holdfast.spatial.vector import outer


class Crossed(NamedTuple):
    """A joint over which the root has moved.

    Attributes:
        body: the body and the response of its joint.
        parent: its parent; `GROUND` for the world.
        frames: the open frames.
        W: (n, m) X H.
    """

    body: SettledBody
    parent: int
    frames: Mapping[int, int]
    W: Array


def cross(now: Belief, body: SettledBody, parent: int) -> tuple[Belief, Crossed]:
    """Return the state with the parent as the root.

    Args:
        now: the state, with beta(k) as its columns.
        body: the body and the response of its joint, with what has been measured.
        parent: its parent; `GROUND` for the world, whose acceleration is given.
    """
    X, D = now.X, body.factors.inverse_pivots
    W = X @ body.motion.H
    columns = forward_substitution(body.factors.L, W.T).T  # W L^-T
    before = np.zeros((len(X), 0))
    if parent != GROUND:
        left = X - np.sum([outer(w, g) for w, g in zip(W.T, body.G.T, strict=True)], axis=0)
        before = array([shift_wrench(body.motion.reach, row) for row in left]).reshape(-1, 6)
    none = np.zeros((before.shape[1], before.shape[1]))
    then = released(now, D, columns)._replace(X=before, N=none)
    return then, Crossed(body, parent, now.frames, W)


def forward_cross(side: Inward, k: int, of: Crossed) -> None:
    """Take a right-hand side across; its load on the root has settled on the body before."""
    side.x = side.x + of.W @ side.nu[k]
    side.on_root = np.zeros(0 if of.parent == GROUND else 6)


def back_cross(back: Back, of: Crossed, nu: Array, beta: Array) -> tuple[Array, Array]:
    """Return qdd and beta of the body, whose parent has the acceleration beta (6,)."""
    s, body = back.stacked(of.frames), of.body
    extra = ldl_solve(body.factors, s @ of.W)
    if body.motion.floats:
        back.beta_root = nu + extra
        return back.beta_root, back.beta_root
    moved = body.moved(beta[:, None])[:, 0]
    qdd = nu + extra - body.G.T @ moved
    back.beta_root = moved + body.motion.H @ qdd
    return qdd, back.beta_root


class AllCrossed(NamedTuple):
    """Joints over which the root has moved together.

    Attributes:
        motions: their bodies, from the world outward.
        frames: the open frames.
        X: (n, c) response to their rates, the outermost first.
        factors: of their mass matrix with N, eliminated from the outermost inward.
    """

    motions: list[BodyMotion]
    frames: Mapping[int, int]
    X: Array
    factors: MaskedLDL


def cross_all(now: Belief, motions: list[BodyMotion], inertias: list[Symmetric6]) -> tuple[Belief, AllCrossed]:
    """Return the state with the world as the root, if the columns are the rates of the joints between.

    Args:
        now: the state.
        motions: the bodies, from the world outward.
        inertias: their inertias with what hangs on them, whose joints are locked.
    """
    M = mass_matrix(motions, inertias) + now.N
    factors, X = ldl(M[::-1, ::-1], np.zeros(len(M))), now.X[:, ::-1]  # positive definite: every pivot counts
    columns = forward_substitution(factors.L, X.T).T  # X L^-T
    then = released(now, factors.inverse_pivots, columns)._replace(X=np.zeros((len(X), 0)), N=np.zeros((0, 0)))
    return then, AllCrossed(motions, now.frames, X, factors)


def forward_cross_all(side: Inward, bodies: Sequence[int], of: AllCrossed) -> Array:
    """Take a right-hand side across; return the rates without s for the way back."""
    eps = rate_torques(of.motions, [side.load[k] for k in bodies], [side.rhs.bodies[k].torque for k in bodies])
    free = ldl_solve(of.factors, (eps - side.on_root)[::-1])
    side.x, side.on_root = side.x + of.X @ free, np.zeros(0)
    return free


def back_cross_all(back: Back, of: AllCrossed, free: Array) -> Array:
    """Return the joint accelerations, from the world outward; they are the columns from here on.

    They are NaN if the mass matrix is singular.
    """
    qdd = (free + ldl_solve(of.factors, back.stacked(of.frames) @ of.X))[::-1]
    largest, first = reduce(maximum, of.factors.pivots, 0.0), qdd[0]
    for pivot in of.factors.pivots:
        first = where(pivot > LEAST_INERTIA * largest, first, float("nan"))
    back.beta_root = concatenate([[first], qdd[1:]])
    return back.beta_root


def columns_of(motions: Sequence[BodyMotion]) -> Array:
    """Return the acceleration of the outermost body per joint rate, (6, c)."""
    reach, columns = np.zeros(3), []
    for body in reversed(motions):
        columns.insert(0, shift_twist(reach, body.H[:, 0]))
        reach = body.reach + reach
    return array(columns).T


def mass_matrix(motions: Sequence[BodyMotion], inertias: Sequence[Symmetric6]) -> Array:
    """Return the mass matrix of the joints of bodies one on the other, (c, c). O(c^2)."""
    n = len(motions)
    M: list[list[Scalar]] = [[0.0] * n for _ in range(n)]
    carried = inertias[-1]
    for k in reversed(range(n)):
        H = motions[k].H[:, 0]
        F = carried.apply(H)
        M[k][k] = H @ F + motions[k].armature[0]
        for j in reversed(range(k)):
            F = shift_wrench(motions[j + 1].reach, F)
            M[j][k] = M[k][j] = motions[j].H[:, 0] @ F
        if k:
            carried = inertias[k - 1].plus(carried.inertia_shifted(motions[k].reach))
    return array(M)


def rate_torques(motions: Sequence[BodyMotion], loads: Sequence[Array], torques: Sequence[Array]) -> Array:
    """Return the torques of the joints minus those that the loads need, (c,)."""
    T, carried = [], np.zeros(6)
    for body, load, torque in zip(reversed(motions), reversed(loads), reversed(torques), strict=True):
        carried = carried + load
        T.insert(0, torque[0] - body.H[:, 0] @ carried)
        carried = shift_wrench(body.reach, carried)
    return array(T)


def released(now: Belief, D: Array, columns: Array) -> Belief:
    """Return the state with sum D w w^T added to the mobility, columns (n, m), and to its sizes."""
    sizes, prior, dense = dict(now.size), dict(now.prior), now.dense()
    for frame in now.frames:
        own = columns[now.slice_of(frame)]
        more = (own * D) @ own.T
        prior[frame] = prior[frame] + more
        for d, w in zip(D, own.T, strict=True):
            turning, moving = d * (w[:3] @ w[:3]), d * (w[3:] @ w[3:])
            sizes[frame] = sizes[frame] + array([turning, moving, moving])
    if dense is not None:
        P = mirrored(dense + (columns * D) @ columns.T)
    else:
        P = now.factors.plus(D.tolist(), list(columns.T)) if now.frames else now.factors
    return now._replace(P=P, size=sizes, prior=prior)
