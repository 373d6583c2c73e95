"""The step in which the root of a part moves inward over a joint, while only free bodies are open.

Everything that has been measured hangs on body k, whose inertia I(k) includes N by now, and whose load z(k) includes n.
With W = X H, the open accelerations x + X beta(k) + P s become functions of the parent's (docs/theory/trunk.md):

    P += W D^-1 W^T,   x += W nu,   X <- (X - W G^T) phi^T
    qdd = nu + D^-1 W^T s - G^T phi^T beta(p),   beta(k) = phi^T beta(p) + H qdd

A free body is crossed likewise, with H = 1 and D = I(k); nothing moves it from the world.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.tree.belief import Belief
from holdfast.dynamics.tree.settled import SettledBody
from holdfast.dynamics.tree.steps import Back, Inward, size_of
from holdfast.model.forest import GROUND
from holdfast.spatial.linalg import ldl_solve
from holdfast.spatial.scalar import Array, array
from holdfast.spatial.spatial_vector import shift_wrench
from holdfast.spatial.symmetric import mirrored
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
    W, columns = X @ body.motion.H, X @ body.columns
    before = np.zeros((len(X), 0))
    if parent != GROUND:
        left = X - np.sum([outer(w, g) for w, g in zip(W.T, body.G.T, strict=True)], axis=0)
        before = array([shift_wrench(body.motion.reach, row) for row in left]).reshape(-1, 6)
    sizes, prior = dict(now.size), dict(now.prior)
    for frame in now.frames:
        own = columns[now.slice_of(frame)]
        more = (own * D) @ own.T
        sizes[frame], prior[frame] = sizes[frame] + size_of(more), prior[frame] + more
    dense = now.dense()
    if dense is not None and len(dense) == len(X):
        P = mirrored(dense + (columns * D) @ columns.T)
    else:
        P = now.factors.plus(D.tolist(), list(columns.T))
    none = np.zeros((before.shape[1], before.shape[1]))
    then = now._replace(X=before, P=P, size=sizes, prior=prior, N=none)
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
