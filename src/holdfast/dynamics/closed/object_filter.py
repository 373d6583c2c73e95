"""The object's filter: every arm measures alpha(C), one after the other, out and back.

x is the acceleration at C of the object and the arms seen so far, P their mobility there. Arm i
says K_i (r_i - A_i alpha(C)) = K_i Lambda_i K_i^T lambda_i, r_i = alpha_f,i + g_i - a_i(C), f_i =
K_i^T lambda_i. With C = K_i A_i, R = K_i Lambda_i K_i^T, S = R + C P C^T:

    out:   x += P C^T S^-1 (K r - C x),   P -= P C^T S^-1 C P        (beyond.md 1(b))
    back:  lambda = S^-1 (K r - C x) - S^-1 C P s,   s += C^T lambda

P is brought down without subtracting: where a rigid grasp measures all of alpha(C) as a parallel
sum (`rigid_step`), elsewhere in factors (`row_steps`). The order of the arms is free, so parallel
sums come first: after one of them P is of the arms' size, however light the object. An arm of
fewer than six joints holds alpha(C) fast in some directions; its rows say so exactly, where the
rounding of a 6x6 R would let a heavy object move. No Lambda_i and no Omega need be regular.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.closed.factored_mobility import FactoredMobility, factored
from holdfast.dynamics.closed.measurement import LIGHTEST_OBJECT, Step, measurement, mobility_ratio, object_share
from holdfast.dynamics.closed.object_motion import ObjectMotion
from holdfast.dynamics.closed.rigid_step import LastStep, last_rigid_step, rigid_step
from holdfast.dynamics.closed.row_steps import row_steps
from holdfast.dynamics.closed.tip_response import TipResponse
from holdfast.spatial.scalar import Array, Scalar, minimum
from holdfast.spatial.spatial_vector import shift_wrench


class ObjectSolution(NamedTuple):
    """Grasp wrenches and object acceleration of one chain.

    Attributes:
        wrenches: per grasp, (6,) f about the contact point, world axes.
        object_acceleration: (6,) alpha(C), less [0; g], world axes.
        mobility: (6, 6) P after the last arm: what a wrench at C moves, world axes.
        rank: rows of the constraint that are independent, contact freedoms included.
        weakest_pivot: the smallest pivot of S kept, relative to its scale.
    """

    wrenches: list[Array]
    object_acceleration: Array
    mobility: Array
    rank: Scalar
    weakest_pivot: Scalar


def object_filter(contacts: list[Contact], tips: list[TipResponse], body: ObjectMotion) -> ObjectSolution:
    """Return grasp wrenches and object acceleration, O(l).

    An external wrench w on the object stays apart: alpha(C) = x + P w at the end, s = w at the
    start of the way back (a light object's M(C)^-1 w would be huge, and taken back later).

    Args:
        contacts: the grasps, in the order of the arms that have one.
        tips: those arms' answers at their tips.
        body: the object.
    """
    seen = [measurement(c, tip, body.mobility) for c, tip in zip(contacts, tips, strict=True)]
    share: Scalar = LIGHTEST_OBJECT
    for m in seen:
        share = object_share(share, mobility_ratio(m))
    scales = [np.diag(m.R) + share * m.object_size for m in seen]
    parallel = [m.carried and m.most >= len(m.r) for m in seen]
    order = sorted(range(len(contacts)), key=lambda i: not parallel[i])

    x, P = body.free_acceleration, body.mobility.dense()
    alpha = x
    factors: FactoredMobility | None = FactoredMobility(*body.mobility_factors)
    steps: list[Step] = []
    wrenches: list[Array] = [body.wrench] * len(contacts)
    turn: LastStep | None = None
    for i in order:
        if not parallel[i]:
            x, factors, step = row_steps(x, factors or factored(P), seen[i], scales[i])
        elif i == order[-1]:
            turn = last_rigid_step(x, P, seen[i], scales[i], body.wrench)
            step = Step(lambda s, end=turn: end.wrench, turn.kept, turn.weakest)
            factors = None
        else:
            x, P, step = rigid_step(x, P, seen[i], scales[i])
            factors = None
        steps.append(step)
    if turn is not None:
        alpha, P = turn.acceleration, turn.mobility
    elif factors is not None:
        alpha, P = x + factors.apply(body.wrench), factors.dense()

    s = body.wrench
    for i, step in reversed(list(zip(order, steps, strict=True))):
        from_arm = step.back(s)
        s = s + from_arm
        wrenches[i] = contacts[i].transmissible(shift_wrench(-contacts[i].offset, from_arm))

    freedoms = sum(len(c.grasp.free) for c in contacts)
    rank = sum((step.kept for step in steps), start=freedoms)
    weakest: Scalar = 1.0
    for step in steps:
        weakest = minimum(weakest, step.weakest)
    return ObjectSolution(wrenches, alpha, P, rank, weakest)
