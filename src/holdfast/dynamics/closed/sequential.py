"""The paper's Kalman filter carried across the arms: O(n) + O(l) for every chain.

Each arm is one more measurement of alpha(C). P is the mobility of the object and the
arms seen so far at C, x their common acceleration there:

    S = K (Lambda_i + A_i P A_i^T) K^T,   Gt = S^-1 K A_i P,   nu = S^-1 K (r_i - A_i x)
    x += (K A_i P)^T nu,   r_i = alpha_f,i + g_i - a_i(C)
    back:  lambda_i = nu - Gt s,   s += A_i^T K^T lambda_i,   f_i = K^T lambda_i

P is brought down without subtracting (beyond.md 1(b')): by the parallel sum P (P + Q)^-1 Q
where the grasp is rigid, by the Joseph form elsewhere. Null pivots of S are dropped, so
no Lambda_i and no Omega need be regular.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution
from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.closed.object_motion import ObjectMotion
from holdfast.dynamics.closed.tip_response import Route, TipResponse, tip_response
from holdfast.spatial.linalg import RANK_TOLERANCE, ldl, ldl_solve
from holdfast.spatial.scalar import Array, Scalar, array, maximum, minimum
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench
from holdfast.spatial.symmetric import mirrored

# Arms less mobile than this part of the object's own mobility set no scale for its pivots.
LIGHTEST_OBJECT = 1e-10


class Measurement(NamedTuple):
    """One arm as the object's filter sees it: K r = K A alpha(C) + K Lambda K^T lambda.

    Attributes:
        R: K Lambda K^T, the "measurement noise".
        C: K A, what is measured.
        r: (6 - n_g,) K r.
    """

    R: Array
    C: Array
    r: Array


class ObjectSolution(NamedTuple):
    """Grasp wrenches and object acceleration of one chain.

    Attributes:
        wrenches: per grasp, (6,) f about the contact point, world axes.
        object_acceleration: (6,) alpha(C), less [0; g], world axes.
        rank: rows of the constraint that are independent, contact freedoms included.
        weakest_pivot: the smallest pivot kept, relative to its scale.
    """

    wrenches: list[Array]
    object_acceleration: Array
    rank: Scalar
    weakest_pivot: Scalar


def measurement(c: Contact, tip: TipResponse) -> Measurement:
    """Return one arm's measurement of alpha(C).

    A rigid grasp is carried to C, where it measures all of alpha(C): C = 1. Elsewhere the
    rows are those the contact transmits, along contact axes.
    """
    r = tip.free_acceleration + c.g - c.a
    if c.grasp.kind == "rigid":
        return Measurement(tip.mobility.mobility_shifted(-c.offset).dense(), np.eye(6), shift_twist(-c.offset, r))
    rows = list(c.grasp.transmitted)
    R = tip.mobility.rotated(c.R.T).dense()[rows][:, rows]
    C = array([shift_wrench(c.offset, row) for row in c.K])  # (K A)^T = A^T K^T
    return Measurement(R, C, c.transmitted(r))


def object_filter(contacts: list[Contact], tips: list[TipResponse], body: ObjectMotion) -> ObjectSolution:
    """Return grasp wrenches and object acceleration, one arm after the other. O(l).

    Args:
        contacts: the grasps, in the order of the arms that have one.
        tips: those arms' answers at their tips.
        body: the object.
    """
    P0 = P = body.mobility.dense()
    x = body.free_acceleration
    seen = [measurement(c, tip) for c, tip in zip(contacts, tips, strict=True)]
    at_object = [m.C @ P0 @ m.C.T for m in seen]
    share = mobility_ratio(seen, at_object)

    steps = []
    rank, weakest = 0, 1.0
    for c, m, own in zip(contacts, seen, at_object, strict=True):
        CP = m.C @ P
        scale = np.diag(m.R) + share * np.diag(own)
        S = ldl(m.R + CP @ m.C.T, scale, RANK_TOLERANCE)
        gain = ldl_solve(S, CP)
        nu = ldl_solve(S, m.r - m.C @ x)
        x = x + CP.T @ nu
        P = parallel_sum(gain, m) if c.grasp.kind == "rigid" else joseph(P, gain, m)
        steps.append((gain, nu))
        rank = rank + S.kept + len(c.grasp.free)
        weakest = minimum(weakest, S.weakest)

    s = np.zeros(6)
    wrenches: list[Array] = []
    for c, m, (gain, nu) in reversed(list(zip(contacts, seen, steps, strict=True))):
        lam = nu - gain @ s
        at_C = m.C.T @ lam
        s = s + at_C
        rigid = c.grasp.kind == "rigid"
        wrenches.insert(0, shift_wrench(-c.offset, at_C) if rigid else c.K.T @ lam)
    return ObjectSolution(wrenches, x, rank, weakest)


def sequential(motion: ChainMotion, route: Route = "auto") -> Solution:
    """Return the closed-chain accelerations: outward stages, object filter, back-substitution.

    Args:
        motion: the chain in motion.
        route: how each arm answers at its tip.
    """
    tips = [tip_response(arm, route) for arm in motion.holding]
    found = object_filter(motion.contacts, tips, motion.body)
    back = [tip.back(f) for tip, f in zip(tips, found.wrenches, strict=True)]
    return Solution(
        qdd=[qdd for qdd, _ in back],
        wrenches=found.wrenches,
        object_acceleration=found.object_acceleration,
        base_wrenches=[base for _, base in back],
        rank=found.rank,
        weakest_pivot=found.weakest_pivot,
    )


def parallel_sum(gain: Array, m: Measurement) -> Array:
    """Return P (P + Q)^-1 Q: the mobility of two bodies joined at C, without subtracting."""
    return mirrored(gain.T @ m.R)


def joseph(P: Array, gain: Array, m: Measurement) -> Array:
    """Return (1 - Gt^T C) P (1 - Gt^T C)^T + Gt^T R Gt: a sum of two semidefinite terms."""
    left = np.eye(6) - gain.T @ m.C
    return mirrored(left @ P @ left.T + gain.T @ m.R @ gain)


def mobility_ratio(seen: list[Measurement], at_object: list[Array]) -> Scalar:
    """Return min(1, the arms' largest mobility over the object's own), without units.

    What the arms leave of the object's mobility in S is of the size of their own; a light
    object's M(C)^-1 is far larger, and as a scale would call sound pivots null.
    """
    ratio = LIGHTEST_OBJECT
    for m, own in zip(seen, at_object, strict=True):
        for arm_entry, object_entry in zip(np.diag(m.R), np.diag(own), strict=True):
            ratio = maximum(ratio, arm_entry / object_entry)
    return minimum(ratio, 1.0)
