"""The object's filter: every row that a grasp transmits measures alpha(C), one after the other.

    c alpha(C) = r - d lambda,      lambda the load along the row

x is the acceleration at C of the object and the rows seen so far, P their mobility there:

    sigma = c P c^T + d,   k = P c^T,   nu = (r - c x) / sigma,   x += k nu,   P -= k k^T / sigma
    back:  lambda = nu - (k . s) / sigma,   s += c^T lambda

The rows of one arm, K_i (r_i - A_i alpha(C)) = K_i Lambda_i K_i^T lambda_i with r_i = alpha_f,i +
g_i - a_i(C), are made independent by K_i Lambda_i K_i^T = L diag(d) L^T. No Lambda_i and no Omega
need be regular: a row whose sigma vanishes repeats earlier ones and is dropped.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.closed.factored_mobility import FactoredMobility, updated
from holdfast.dynamics.closed.object_motion import ObjectMotion
from holdfast.dynamics.closed.tip_response import TipResponse
from holdfast.spatial.linalg import RANK_TOLERANCE, back_substitution, forward_substitution, ldl
from holdfast.spatial.scalar import Array, Scalar, array, maximum, minimum, where
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench

# Arms less mobile than this part of the object's own mobility set no scale for its pivots.
LIGHTEST_OBJECT = 1e-10
# A pivot of K Lambda K^T below this part of its diagonal is rounding: the arm cannot move there.
ROUNDING = 1e-15


class Measurement(NamedTuple):
    """One arm as the object's filter sees it: rows C alpha(C) = r - R lambda.

    Along contact axes; for a rigid grasp about C along world axes, where C is the identity.

    Attributes:
        C: K A, (rows, 6).
        R: K Lambda K^T, the "measurement noise".
        r: (rows,) K (alpha_f + g - a).
        object_size: (rows,) diagonal of C M(C)^-1 C^T: how the free object moves.
    """

    C: Array
    R: Array
    r: Array
    object_size: Array


class ObjectSolution(NamedTuple):
    """Grasp wrenches and object acceleration of one chain.

    Attributes:
        wrenches: per grasp, (6,) f about the contact point, world axes.
        object_acceleration: (6,) alpha(C), less [0; g], world axes.
        mobility: P after the last arm: what a wrench at C moves, world axes.
        rank: rows of the constraint that are independent, contact freedoms included.
        weakest_pivot: the smallest sigma kept, relative to its scale.
    """

    wrenches: list[Array]
    object_acceleration: Array
    mobility: FactoredMobility
    rank: Scalar
    weakest_pivot: Scalar


def measurement(c: Contact, tip: TipResponse, body: ObjectMotion) -> Measurement:
    """Return one arm's measurement of alpha(C)."""
    r = tip.free_acceleration + c.g - c.a
    if c.grasp.kind == "rigid":
        C, R, r = np.eye(6), tip.mobility.mobility_shifted(-c.offset).dense(), shift_twist(-c.offset, r)
    else:
        rows = list(c.grasp.transmitted)
        C = array([shift_wrench(c.offset, row) for row in c.K])  # (K A)^T = A^T K^T
        R, r = tip.mobility.rotated(c.R.T).dense()[rows][:, rows], c.transmitted(r)
    return Measurement(C, R, r, array([row @ body.mobility.apply(row) for row in C]))


def object_filter(contacts: list[Contact], tips: list[TipResponse], body: ObjectMotion) -> ObjectSolution:
    """Return grasp wrenches and object acceleration, one arm after the other. O(l).

    An external wrench w on the object stays apart: alpha(C) = x + P w at the end, s = w at the
    start of the way back.

    Args:
        contacts: the grasps, in the order of the arms that have one.
        tips: those arms' answers at their tips.
        body: the object.
    """
    seen = [measurement(c, tip, body) for c, tip in zip(contacts, tips, strict=True)]
    share = mobility_ratio(seen)
    x, P = body.free_acceleration, FactoredMobility(*body.mobility_factors)
    steps = []
    rank, weakest = 0, 1.0
    for c, m in zip(contacts, seen, strict=True):
        scale = np.diag(m.R) + share * m.object_size
        L, d, *_ = ldl(m.R, scale, ROUNDING)
        rows, gains, innovations = forward_substitution(L, m.C), [], []
        for row, noise, measured, size in zip(rows, d, forward_substitution(L, m.r), scale, strict=True):
            P, k, sigma, alive = updated(P, row, noise, RANK_TOLERANCE * size)
            inverse = where(alive, 1.0 / where(alive, sigma, 1.0), 0.0)
            nu = (measured - row @ x) * inverse
            x = x + nu * k
            gains.append(inverse * k)
            innovations.append(nu)
            rank = rank + where(alive, 1, 0)
            weakest = minimum(weakest, where(alive, sigma / where(alive, size, 1.0), 1.0))
        rank = rank + len(c.grasp.free)
        steps.append((L, rows, gains, innovations))

    s = body.wrench
    wrenches: list[Array] = []
    for c, (L, rows, gains, innovations) in reversed(list(zip(contacts, steps, strict=True))):
        loads: list[Scalar] = []
        for row, gain, nu in reversed(list(zip(rows, gains, innovations, strict=True))):
            load = nu - gain @ s
            s = s + load * row
            loads.insert(0, load)
        lam = back_substitution(L, array(loads))
        wrenches.insert(0, shift_wrench(-c.offset, lam) if c.grasp.kind == "rigid" else c.K.T @ lam)
    return ObjectSolution(wrenches, x + P.apply(body.wrench), P, rank, weakest)


def mobility_ratio(seen: list[Measurement]) -> Scalar:
    """Return min(1, the arms' largest mobility over the object's own), without units.

    What the arms leave of the object's mobility is of the size of their own; a light object's
    M(C)^-1 is far larger, and as a scale would call sound rows null.
    """
    ratio = LIGHTEST_OBJECT
    for m in seen:
        for arm_size, object_size in zip(np.diag(m.R), m.object_size, strict=True):
            ratio = maximum(ratio, arm_size / object_size)
    return minimum(ratio, 1.0)
