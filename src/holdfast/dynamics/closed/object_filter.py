"""The object's filter: every arm measures alpha(G), one after the other, out and back.

x is the acceleration of the mass centre G with the arms seen so far, P their mobility there. Arm i
says K_i (r_i - A_i alpha(G)) = K_i Lambda_i K_i^T lambda_i, r_i = alpha_f,i + g_i - a_i(G), f_i =
K_i^T lambda_i. With C = K_i A_i, R = K_i Lambda_i K_i^T, S = R + C P C^T:

    out:   x += P C^T S^-1 (K r - C x),   P -= P C^T S^-1 C P        (docs/theory/sequential_filter.md)
    back:  lambda = S^-1 (K r - C x) - S^-1 C P s,   s += C^T lambda

P is brought down without subtracting: where a rigid grasp measures all of alpha(C) as a parallel
sum (`rigid_update`), elsewhere in factors (`row_updates`). The order of the arms is free, so parallel
sums come first: after one of them P is of the arms' size, however light the object. An arm of
fewer than six joints holds alpha(G) fast in some directions; its rows say so exactly, where the
rounding of a 6x6 R would let a heavy object move. No Lambda_i and no Omega need be regular.
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

LEAST_MOBILE = 1e-16  # of the object's own mobility


Again = Callable[[list[Array], Array], tuple[list[Array], Array]]


class ObjectSolution(NamedTuple):
    """Grasp wrenches and object acceleration of one chain.

    Attributes:
        wrenches: per grasp, (6,) f about the contact point, world axes.
        object_acceleration: (6,) alpha(C), less [0; g], world axes.
        mobility: (6, 6) P after the last arm: what a wrench at C moves, world axes.
        rank: rows of the constraint that are independent, contact freedoms included.
        weakest_pivot: the smallest pivot of S kept, relative to a typical one.
        independent: per grasp, (rows,) 1 for the rows that are kept, if the contacts say which are held.
        again: per grasp (6,) r about the contact point, and (6,) wrench on the object about C, world axes -> wrenches
            and object acceleration of the chain at rest, by the factors at hand.
        second: the same of what was given beforehand.
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
    """Return grasp wrenches and object acceleration, O(l).

    An external wrench w on the object stays apart: alpha(G) = x + P w at the end, s = w at the
    start of the way back (a light object's M(G)^-1 w would be huge, and taken back later).

    Args:
        contacts: the grasps, in the order of the arms that have one.
        tips: those arms' answers at their tips.
        body: the object.
        tolerance: relative size of a pivot that counts as zero, where the contacts say which rows are held.
        second: what `again` would be given, if it is known beforehand: on the same way out and back.
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


Passed = tuple[Update, BackSubstitution | None]  # an arm's update, and the second's way back


def rigid_arm(carry: tuple[Any, ...], m: Measurement, r: Array | None) -> tuple[tuple[Any, ...], Passed]:
    """Return the filter after an arm taken as a parallel sum, and its ways back; r is the second's, or None."""
    x, P, size, kept, weakest, x2 = carry
    x, P, update = rigid_update(x, P, m, size)
    size = minimum(size, size_at_centre(m.extent))
    x2, back = passed(update, x2, r)
    return (x, P, size, kept + update.kept, minimum(weakest, update.weakest), x2), (update, back)


def arm_by_rows(
    carry: tuple[Any, ...], m: Measurement, r: Array | None, size: Array, tolerance: float
) -> tuple[tuple[Any, ...], Passed]:
    """Return the filter after an arm taken by its rows, and its ways back; r is the second's, or None."""
    x, P, kept, weakest, x2 = carry
    x, P, update = row_updates(x, P, m, size, tolerance)
    x2, back = passed(update, x2, r)
    return (x, P, kept + update.kept, minimum(weakest, update.weakest), x2), (update, back)


def passed(update: Update, x: Array | None, r: Array | None) -> tuple[Array | None, BackSubstitution | None]:
    """Return the second's x after an arm and its way back; None without one."""
    if x is None or r is None or update.again is None:
        return None, None
    return update.again(x, r)


def back_substituted(
    s: tuple[Array, Array | None], arm: Passed
) -> tuple[tuple[Array, Array | None], tuple[Array, Array | None]]:
    """Return the wrenches at G of everything behind an arm and of the arm itself, and the arm's own."""
    update, second = arm
    behind, from_arm = through(s[0], update.back_substitute)
    if second is None or s[1] is None:
        return (behind, None), (from_arm, None)
    behind2, from_arm2 = through(s[1], second)
    return (behind, behind2), (from_arm, from_arm2)


def through(s: Array, back_substitute: BackSubstitution) -> tuple[Array, Array]:
    """Return what `back_substituted` does, of one way back."""
    from_arm = back_substitute(s)
    return s + from_arm, from_arm


def wrench_at_contact(about: Contact, from_arm: Array) -> Array:
    """Return an arm's wrench about its contact point, free moments taken as exactly 0, (6,)."""
    return about.transmissible(shift_wrench(-about.offset, from_arm))


def initial_size(body: FreeBody, seen: list[Measurement]) -> Array:
    """Return (3,) how mobile the object is before the first arm, for judging pivots; see `size_at_centre`.

    What the arms leave of a light object's mobility is of the size of their own, so it counts as no more. Anchors do
    not yield, and leave nothing or all of it; bushings have no rows.
    """
    own, seen = own_size(body), [m for m in seen if m.most and len(m.r)]
    if not seen:
        return own
    least = LEAST_MOBILE * own  # sliding joints do not turn at all
    most, _ = scan(lambda size, m: (maximum(size, size_at_centre(m.extent)), None), least, seen)
    return minimum(own, most)


def own_size(body: FreeBody) -> Array:
    """Return (3,) how mobile the object is by itself."""
    turning, moving = block_sizes(body.mobility)
    return array([turning, moving, moving])


def by_rows(size: Array) -> Array:
    """Return (6,) the sizes of the rows of P."""
    return np.repeat(size[:2], 3)
