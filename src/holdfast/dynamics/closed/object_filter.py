"""The object's filter: every arm measures alpha(G), one after the other, out and back.

x is the acceleration of the mass centre G with the arms seen so far, P their mobility there. Arm i
says K_i (r_i - A_i alpha(G)) = K_i Lambda_i K_i^T lambda_i, r_i = alpha_f,i + g_i - a_i(G), f_i =
K_i^T lambda_i. With C = K_i A_i, R = K_i Lambda_i K_i^T, S = R + C P C^T:

    out:   x += P C^T S^-1 (K r - C x),   P -= P C^T S^-1 C P        (beyond.md 1(b))
    back:  lambda = S^-1 (K r - C x) - S^-1 C P s,   s += C^T lambda

P is brought down without subtracting: where a rigid grasp measures all of alpha(C) as a parallel
sum (`rigid_step`), elsewhere in factors (`row_steps`). The order of the arms is free, so parallel
sums come first: after one of them P is of the arms' size, however light the object. An arm of
fewer than six joints holds alpha(G) fast in some directions; its rows say so exactly, where the
rounding of a 6x6 R would let a heavy object move. No Lambda_i and no Omega need be regular.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.closed.factored_mobility import FactoredMobility, factored
from holdfast.dynamics.closed.measurement import Measurement, Step, block_sizes, measurement, size_at_centre
from holdfast.dynamics.closed.object_motion import FreeBody, acceleration_at_C
from holdfast.dynamics.closed.rigid_step import LastStep, last_rigid_step, rigid_step
from holdfast.dynamics.closed.row_steps import row_steps
from holdfast.dynamics.closed.tip_response import TipResponse
from holdfast.spatial.scalar import Array, Scalar, array, maximum, minimum
from holdfast.spatial.spatial_vector import shift_wrench
from holdfast.spatial.symmetric import symmetric6

LEAST_MOBILE = 1e-16  # of the object's own mobility


class ObjectSolution(NamedTuple):
    """Grasp wrenches and object acceleration of one chain.

    Attributes:
        wrenches: per grasp, (6,) f about the contact point, world axes.
        object_acceleration: (6,) alpha(C), less [0; g], world axes.
        mobility: (6, 6) P after the last arm: what a wrench at C moves, world axes.
        rank: rows of the constraint that are independent, contact freedoms included.
        weakest_pivot: the smallest pivot of S kept, relative to a typical one.
    """

    wrenches: list[Array]
    object_acceleration: Array
    mobility: Array
    rank: Scalar
    weakest_pivot: Scalar


def object_filter(contacts: list[Contact], tips: list[TipResponse], body: FreeBody) -> ObjectSolution:
    """Return grasp wrenches and object acceleration, O(l).

    An external wrench w on the object stays apart: alpha(G) = x + P w at the end, s = w at the
    start of the way back (a light object's M(G)^-1 w would be huge, and taken back later).

    Args:
        contacts: the grasps, in the order of the arms that have one.
        tips: those arms' answers at their tips.
        body: the object.
    """
    about = [c.about(body.centre, body.centripetal) for c in contacts]
    seen = [measurement(c, tip) for c, tip in zip(about, tips, strict=True)]
    size = initial_size(body, seen)
    parallel = [m.carried and m.most >= len(m.r) for m in seen]
    order = sorted(range(len(contacts)), key=lambda i: not parallel[i])

    x, P = body.acceleration, body.mobility.dense()
    alpha = x
    factors: FactoredMobility | None = FactoredMobility(body.D, body.w)
    steps: list[Step] = []
    wrenches: list[Array] = [body.wrench] * len(contacts)
    turn: LastStep | None = None
    for i in order:
        m = seen[i]
        if not parallel[i]:
            x, factors, step = row_steps(x, factors or factored(P, by_rows(size)), m, size)
        elif i == order[-1]:
            turn = last_rigid_step(x, P, m, size, body.wrench)
            step = Step(lambda s, end=turn: end.wrench, turn.kept, turn.weakest)
            factors = None
        else:
            x, P, step = rigid_step(x, P, m, size)
            size, factors = minimum(size, size_at_centre(m.extent)), None
        steps.append(step)
    if turn is not None:
        alpha, P = turn.acceleration, turn.mobility
    elif factors is not None:
        alpha, P = x + factors.apply(body.wrench), factors.dense()

    s = body.wrench
    for i, step in reversed(list(zip(order, steps, strict=True))):
        from_arm = step.back(s)
        s = s + from_arm
        wrenches[i] = contacts[i].transmissible(shift_wrench(-about[i].offset, from_arm))

    freedoms = sum(len(c.grasp.free) for c in contacts)
    rank = sum((step.kept for step in steps), start=freedoms)
    weakest: Scalar = 1.0
    for step in steps:
        weakest = minimum(weakest, step.weakest)
    mobility = symmetric6(P).mobility_shifted(-body.centre).dense()
    return ObjectSolution(wrenches, acceleration_at_C(body.centre, body.centripetal, alpha), mobility, rank, weakest)


def initial_size(body: FreeBody, seen: list[Measurement]) -> Array:
    """Return (3,) how mobile the object is before the first arm, for judging pivots; see `size_at_centre`.

    What the arms leave of a light object's mobility is of the size of their own, so it counts as no more.
    """
    most = LEAST_MOBILE * own_size(body)  # sliding joints do not turn at all
    for m in seen:
        most = maximum(most, size_at_centre(m.extent))
    return minimum(own_size(body), most)


def own_size(body: FreeBody) -> Array:
    """Return (3,) how mobile the object is by itself."""
    turning, moving = block_sizes(body.mobility)
    return array([turning, moving, moving])


def by_rows(size: Array) -> Array:
    """Return (6,) the sizes of the rows of P."""
    return np.repeat(size[:2], 3)
