"""The object's filter, in which every arm in turn is a measurement of alpha(G), in a forward and a backward pass.

Let x be the acceleration of the mass centre G with the arms included so far, and P the mobility there. The equations of
arm i are K_i (r_i - A_i alpha(G)) = K_i Lambda_i K_i^T lambda_i with r_i = alpha_f,i + g_i - a_i(G) and
f_i = K_i^T lambda_i. With C = K_i A_i, R = K_i Lambda_i K_i^T, S = R + C P C^T:
    forward:   x += P C^T S^-1 (K r - C x),   P -= P C^T S^-1 C P        (docs/theory/sequential_filter.md)
    backward:  lambda = S^-1 (K r - C x) - S^-1 C P s,   s += C^T lambda
P is updated without subtraction: for a rigid grasp, which measures all of alpha(C), by a parallel sum (`rigid_update`),
otherwise in factored form (`row_updates`). The order of the arms is arbitrary, so parallel sums come first. After one
of them P is of the size of the arms' mobility, however light the object is. An arm with fewer than six joints fixes
some components of alpha(G). Its rows impose this exactly, whereas the rounding of a 6x6 matrix R would let a heavy
object move. Neither the Lambda_i nor Omega need be regular.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.closed.factored_mobility import FactoredMobility, factored
from holdfast.dynamics.closed.measurement import (
    BackSubstitution,
    Measurement,
    Update,
    block_sizes,
    measurement,
    seen_along,
    size_at_centre,
)
from holdfast.dynamics.closed.object_motion import FreeBody, acceleration_at_C
from holdfast.dynamics.closed.rigid_update import TerminalUpdate, rigid_update, terminal_update
from holdfast.dynamics.closed.row_updates import row_updates
from holdfast.dynamics.closed.tip_response import TipResponse
from holdfast.spatial.linalg import RANK_TOLERANCE
from holdfast.spatial.scalar import Array, Scalar, array, each, maximum, minimum, scan
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench
from holdfast.spatial.symmetric import symmetric6

LEAST_MOBILE = 1e-16  # relative to the object's own mobility


Again = Callable[[list[Array], Array], tuple[list[Array], Array]]


class ObjectSolution(NamedTuple):
    """The grasp wrenches and the object acceleration of one chain.

    Attributes:
        wrenches: per grasp, (6,) f about the contact point, world axes.
        object_acceleration: (6,) alpha(C) minus [0; g], world axes.
        mobility: (6, 6) P after the last arm, the mobility of the whole chain at C, world axes.
        rank: number of independent rows of the constraint, contact freedoms included.
        weakest_pivot: the smallest pivot of S for an independent row, relative to a typical one.
        independent: per grasp, (rows,) 1 for the independent rows, if the contacts have masks of rows.
        again: function of r (6,) about the contact point of each grasp and of the wrench (6,) on the object about C,
            world axes; it returns the wrenches and the object acceleration of the chain at rest, using the same
            factors.
        second: the result of `again` for the argument `second` of the filter.
    """

    wrenches: list[Array]
    object_acceleration: Array
    mobility: Array
    rank: Scalar
    weakest_pivot: Scalar
    independent: list[Array | None]
    again: Again | None = None
    second: tuple[list[Array], Array] | None = None


def object_filter(
    contacts: list[Contact],
    tips: list[TipResponse],
    body: FreeBody,
    tolerance: float = RANK_TOLERANCE,
    second: tuple[list[Array], Array] | None = None,
) -> ObjectSolution:
    """Return the grasp wrenches and the object acceleration, O(l).

    An external wrench w on the object is treated separately: alpha(G) = x + P w at the end, and s = w at the start of
    the backward pass. (The acceleration M(G)^-1 w of a light object would be huge, and would cancel later.)

    Args:
        contacts: the grasps, in the order of the arms that have one.
        tips: the tip responses of these arms.
        body: the object.
        tolerance: relative size of a pivot that counts as zero, if the contacts have masks of rows.
        second: arguments of `again`, if they are known in advance; they are processed in the same two passes.
    """
    about = each(lambda c: c.about(body.centre, body.centripetal), contacts)
    seen = each(measurement, about, tips)
    first = [i for i, m in enumerate(seen) if m.parallel]
    then = [i for i, m in enumerate(seen) if not m.parallel]
    size = initial_size(body, [seen[i] for i in [*first, *then]])
    last = first.pop() if first and not then else None
    freedoms = sum(len(c.grasp.free) for c in contacts)
    dense = body.mobility.dense() if first or last is not None else None
    others: list[Any] = [None for _ in seen]
    w2 = x2 = alpha2 = s2 = None
    if second is not None:
        others, w2, x2 = each(seen_along, about, seen, second[0]), shift_wrench(-body.centre, second[1]), np.zeros(6)
    (x, P, size, kept, weakest, x2), sums = scan(
        rigid_arm,
        (body.acceleration, dense, size, freedoms, 1.0, x2),
        [seen[i] for i in first],
        [others[i] for i in first],
    )
    ends: list[TerminalUpdate] = []
    factors: Any = None
    if last is not None:
        ends = each(lambda m: terminal_update(x, P, m, size, body.wrench), [seen[last]])
        (end,) = ends
        ((alpha, from_last),) = each(lambda update: update.answer(), ends)
        P, kept, weakest = end.mobility, kept + end.kept, minimum(weakest, end.weakest)
        s, rows, from_rows = body.wrench + from_last, [], [(from_last, None)]
        if second is not None:
            ((alpha2, own),) = each(lambda end, r: end.again(x2, r, w2), ends, [others[last]])
            s2, from_rows = w2 + own, [(from_last, own)]
    else:
        (factors,) = each(factored, [P], [by_rows(size)]) if first else [FactoredMobility(body.D, body.w)]
        (x, factors, kept, weakest, x2), rows = scan(
            lambda carry, m, r: arm_by_rows(carry, m, r, size, tolerance),
            (x, factors, kept, weakest, x2),
            [seen[i] for i in then],
            [others[i] for i in then],
        )
        alpha, P = x + factors.apply(body.wrench), factors.dense()
        alpha2 = None if second is None else x2 + factors.apply(w2)
        (s, s2), from_rows = scan(back_substituted, (body.wrench, w2), rows[::-1])
    _, from_sums = scan(back_substituted, (s, s2), sums[::-1])

    order = [*first, *([] if last is None else [last]), *then]
    found = dict(zip(order, [*from_sums[::-1], *from_rows[::-1]], strict=True))
    wrenches = each(wrench_at_contact, about, [found[i][0] for i in range(len(contacts))])
    solved = None
    if alpha2 is not None:
        wrenches2 = each(wrench_at_contact, about, [found[i][1] for i in range(len(contacts))])
        solved = wrenches2, shift_twist(-body.centre, alpha2)
    mobility = symmetric6(P).mobility_shifted(-body.centre).dense()
    acceleration = acceleration_at_C(body.centre, body.centripetal, alpha)
    chosen: list[Array | None] = [update.independent for update, _ in rows] if len(then) == len(contacts) else []

    def again(gaps: list[Array], wrench: Array) -> tuple[list[Array], Array]:
        r = each(seen_along, about, seen, gaps)
        w = shift_wrench(-body.centre, wrench)
        x, back_sums = scan(lambda x, u, r: u[0].again(x, r), np.zeros(6), sums, [r[i] for i in first])
        if last is not None:
            ((alpha, own),) = each(lambda end, r: end.again(x, r, w), ends, [r[last]])
            s, from_rows = w + own, [own]
        else:
            x, back_rows = scan(lambda x, u, r: u[0].again(x, r), x, rows, [r[i] for i in then])
            alpha = x + factors.apply(w)
            s, from_rows = scan(through, w, back_rows[::-1])
        s, from_sums = scan(through, s, back_sums[::-1])
        found = dict(zip(order, [*from_sums[::-1], *from_rows[::-1]], strict=True))
        wrenches = each(wrench_at_contact, about, [found[i] for i in range(len(contacts))])
        return wrenches, shift_twist(-body.centre, alpha)

    return ObjectSolution(wrenches, acceleration, mobility, kept, weakest, chosen, again, solved)


Passed = tuple[Update, BackSubstitution | None]  # an arm's update, and the back-substitution of the second solve


def rigid_arm(carry: tuple[Any, ...], m: Measurement, r: Array | None) -> tuple[tuple[Any, ...], Passed]:
    """Return the filter after an arm included by a parallel sum, and its back-substitutions.

    The argument r belongs to the second solve, or is None.
    """
    x, P, size, kept, weakest, x2 = carry
    x, P, update = rigid_update(x, P, m, size)
    size = minimum(size, size_at_centre(m.extent))
    x2, back = passed(update, x2, r)
    return (x, P, size, kept + update.kept, minimum(weakest, update.weakest), x2), (update, back)


def arm_by_rows(
    carry: tuple[Any, ...], m: Measurement, r: Array | None, size: Array, tolerance: float
) -> tuple[tuple[Any, ...], Passed]:
    """Return the filter after an arm included by its rows, and its back-substitutions.

    The argument r belongs to the second solve, or is None.
    """
    x, P, kept, weakest, x2 = carry
    x, P, update = row_updates(x, P, m, size, tolerance)
    x2, back = passed(update, x2, r)
    return (x, P, kept + update.kept, minimum(weakest, update.weakest), x2), (update, back)


def passed(update: Update, x: Array | None, r: Array | None) -> tuple[Array | None, BackSubstitution | None]:
    """Return x of the second solve after an arm, and its back-substitution; None without a second solve."""
    if x is None or r is None or update.again is None:
        return None, None
    return update.again(x, r)


def back_substituted(
    s: tuple[Array, Array | None], arm: Passed
) -> tuple[tuple[Array, Array | None], tuple[Array, Array | None]]:
    """Return the summed wrenches at G of the later arms and this one, and those of this arm, for both solves."""
    update, second = arm
    behind, from_arm = through(s[0], update.back_substitute)
    if second is None or s[1] is None:
        return (behind, None), (from_arm, None)
    behind2, from_arm2 = through(s[1], second)
    return (behind, behind2), (from_arm, from_arm2)


def through(s: Array, back_substitute: BackSubstitution) -> tuple[Array, Array]:
    """Return the result of `back_substituted` for one of the solves."""
    from_arm = back_substitute(s)
    return s + from_arm, from_arm


def wrench_at_contact(about: Contact, from_arm: Array) -> Array:
    """Return an arm's wrench about its contact point with its free components set to exactly 0, (6,)."""
    return about.transmissible(shift_wrench(-about.offset, from_arm))


def initial_size(body: FreeBody, seen: list[Measurement]) -> Array:
    """Return the size of the object's mobility before the first arm, (3,), for judging pivots; see `size_at_centre`.

    The mobility of a light object is limited to that of the arms, because P is of that size once the arms are included.
    Anchors, which do not move, and bushings, which have no rows, are left out.
    """
    own, seen = own_size(body), [m for m in seen if m.most and len(m.r)]
    if not seen:
        return own
    least = LEAST_MOBILE * own  # the angular mobility of sliding joints is zero
    most, _ = scan(lambda size, m: (maximum(size, size_at_centre(m.extent)), None), least, seen)
    return minimum(own, most)


def own_size(body: FreeBody) -> Array:
    """Return the size of the object's own mobility, (3,)."""
    turning, moving = block_sizes(body.mobility)
    return array([turning, moving, moving])


def by_rows(size: Array) -> Array:
    """Return the sizes of the rows of P, (6,)."""
    return np.repeat(size[:2], 3)
