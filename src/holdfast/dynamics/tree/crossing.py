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
from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.closed.tip_response import if_regular
from holdfast.dynamics.tree.belief import Belief
from holdfast.dynamics.tree.forest_motion import BodyMotion, Limb
from holdfast.dynamics.tree.order import Cross, CrossAll
from holdfast.dynamics.tree.right_hand_sides import Inward, Outward
from holdfast.dynamics.tree.settled import SettledBody
from holdfast.dynamics.tree.steps import PartMotion, StepKind, one_by_one
from holdfast.model.forest import GROUND
from holdfast.spatial.linalg import MaskedLDL, forward_substitution, ldl, ldl_solve
from holdfast.spatial.scalar import Array, Scalar, array
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench
from holdfast.spatial.symmetric import Symmetric6, mirrored, symmetric6
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


def cross(now: Belief, step: Cross, of: PartMotion) -> tuple[Belief, Crossed]:
    """Let what has been measured settle on the root, and the root on its parent, which is the root from here on."""
    of.settling.add(step.body, symmetric6(now.N))
    return across(now, of.settling.settle(step.body), of.motion.topology.parents[step.body])


def across(now: Belief, body: SettledBody, parent: int) -> tuple[Belief, Crossed]:
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
    count = before.shape[1]
    root = np.eye(6)[:, :count]
    then = released(now, D, columns)._replace(root=root, X=before, N=np.zeros((count, count)))
    return then, Crossed(body, parent, now.frames, W)


def forward_cross(side: Inward, step: Cross, of: Crossed) -> Array:
    """Let the load on the root settle, and take a right-hand side across; return nu of the joint."""
    k = step.body
    side.load[k] = side.load[k] + side.on_root - side.rhs.bodies[k].wrench
    side.settle(k, of.parent, of.body)
    side.x, side.on_root = side.x + of.W @ side.nu[k], np.zeros(0 if of.parent == GROUND else 6)
    return side.nu[k]


def back_cross(back: Outward, step: Cross, of: Crossed, nu: Array) -> None:
    """Find the acceleration of the body, whose parent's is known."""
    s, body = back.stacked(of.frames), of.body
    extra = ldl_solve(body.factors, s @ of.W)
    if body.motion.floats:
        qdd = back.columns = nu + extra
    else:
        moved = body.moved(back.beta[of.parent][:, None])[:, 0]
        qdd = nu + extra - body.G.T @ moved
        back.columns = moved + body.motion.H @ qdd
    back.moves(step.body, qdd, back.columns)


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


def cross_all(now: Belief, step: CrossAll, of: PartMotion) -> tuple[Belief, AllCrossed]:
    """Move the root to the world, if the columns are the rates of the joints between."""
    motions = [of.motion.bodies[k] for k in step.bodies]
    N = now.N
    for limb in _on_rates(of.motion.all_limbs, step):
        N = N + limb.tip.base.Y
    M = mass_matrix(motions, [of.settling.inertia[k] for k in step.bodies]) + mirrored(N)
    factors, X = ldl(M[::-1, ::-1], np.zeros(len(M))), now.X[:, ::-1]  # positive definite: every pivot counts
    columns = forward_substitution(factors.L, X.T).T  # X L^-T
    then = released(now, factors.inverse_pivots, columns)
    then = then._replace(root=np.zeros((6, 0)), X=np.zeros((len(X), 0)), N=np.zeros((0, 0)))
    return then, AllCrossed(motions, now.frames, X, factors)


def forward_cross_all(side: Inward, step: CrossAll, of: AllCrossed) -> Array:
    """Take a right-hand side across; return the rates without s for the way back."""
    bodies, on_root = step.bodies, side.on_root
    for limb in _on_rates(side.rhs.limbs, step):
        on_root = on_root + limb.tip.base.wrench
    eps = rate_torques(of.motions, [side.load[k] for k in bodies], [side.rhs.bodies[k].torque for k in bodies])
    free = ldl_solve(of.factors, (eps - on_root)[::-1])
    side.x, side.on_root = side.x + of.X @ free, np.zeros(0)
    return free


def back_cross_all(back: Outward, step: CrossAll, of: AllCrossed, free: Array) -> None:
    """Find the joint accelerations, which are the columns from here on, and those of their bodies.

    They are NaN if the mass matrix is singular.
    """
    qdd = (free + ldl_solve(of.factors, back.stacked(of.frames) @ of.X))[::-1]
    back.columns, under = if_regular(qdd, of.factors.pivots), np.zeros(6)
    for a, k, body in zip(back.columns, step.bodies, of.motions, strict=True):
        under = shift_twist(body.reach, under) + a * body.H[:, 0]
        back.moves(k, array([a]), under)


def _on_rates(limbs: Sequence[Limb], step: CrossAll) -> list[Any]:
    """Return the limbs whose base columns are the rates of the joints that are crossed."""
    return [limb for limb in limbs if limb.on == step.bodies[-1] and limb.tip.base is not None]


CROSSING_STEPS: dict[type, StepKind] = {
    Cross: one_by_one(cross, forward_cross, back_cross),
    CrossAll: one_by_one(cross_all, forward_cross_all, back_cross_all),
}


def columns_of(axes: Sequence[Array], reaches: Sequence[Array]) -> Array:
    """Return the acceleration of the outermost body per joint rate, (6, c).

    Args:
        axes: (6,) H of bodies one on the other, from the world outward.
        reaches: (3,) from the origin of the body before to its own [m].
    """
    reach, columns = np.zeros(3), []
    for H, own in zip(reversed(axes), reversed(reaches), strict=True):
        columns.insert(0, shift_twist(reach, H))
        reach = own + reach
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
