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
from holdfast.dynamics.closed.filter_updates import (
    Included,
    ParallelSum,
    RowSums,
    TerminalSum,
    parallel_sum,
    row_sums,
    terminal_sum,
)
from holdfast.dynamics.closed.measurement import (
    Measurement,
    block_sizes,
    measurement,
    seen_along,
    size_at_centre,
)
from holdfast.dynamics.closed.object_motion import FreeBody, acceleration_at_C
from holdfast.dynamics.closed.tip_response import TipResponse
from holdfast.spatial.linalg import RANK_TOLERANCE
from holdfast.spatial.scalar import Array, Scalar, array, each, maximum, minimum, scan
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench
from holdfast.spatial.symmetric import symmetric6

LEAST_MOBILE = 1e-16  # relative to the object's own mobility


FactoredSolve = Callable[[list[Array], Array], tuple[list[Array], Array]]


class ObjectSolution(NamedTuple):
    """The grasp wrenches and the object acceleration of one chain.

    Attributes:
        wrenches: per grasp, (6,) f about the contact point, world axes.
        object_acceleration: (6,) alpha(C) minus [0; g], world axes.
        mobility: (6, 6) P after the last arm, the mobility of the whole chain at C, world axes.
        rank: number of independent rows of the constraint, contact freedoms included.
        weakest_pivot: the smallest pivot of S for an independent row, relative to a typical one.
        independent: per grasp, (rows,) 1 for the independent rows, if the contacts have masks of rows.
        solve_with_factors: function of r (6,) about the contact point of each grasp and of the wrench (6,) on the
            object about C, world axes; it returns the wrenches and the object acceleration of the chain at rest, using
            the same factors.
        second: the result of `solve_with_factors` for the argument `second` of the filter.
    """

    wrenches: list[Array]
    object_acceleration: Array
    mobility: Array
    rank: Scalar
    weakest_pivot: Scalar
    independent: list[Array | None]
    solve_with_factors: FactoredSolve | None = None
    second: tuple[list[Array], Array] | None = None


class Order(NamedTuple):
    """The order in which the arms are included, by the index of their grasp.

    Attributes:
        parallel: the arms included by a parallel sum, which come first.
        terminal: the last of them, which needs fewer operations if no arm follows it; otherwise empty.
        by_rows: the arms included by their rows.
    """

    parallel: list[int]
    terminal: list[int]
    by_rows: list[int]


class Filter(NamedTuple):
    """The filter after some of the arms.

    Attributes:
        x: acceleration of G, (6,) for every right-hand side.
        P: mobility there, (6, 6), or in factored form if arms are included by their rows.
        rank: number of independent rows so far.
        weakest: the smallest pivot for an independent row, relative to a typical one.
    """

    x: list[Array]
    P: Any
    rank: Scalar
    weakest: Scalar


class Factors(NamedTuple):
    """The factors of the filter, for further right-hand sides.

    Attributes:
        centre: (3,) p, from C to G [m].
        about: the contacts about G.
        seen: the arms' measurements.
        order: the order of the arms.
        sums: factors of the arms of `order.parallel`.
        end: factors of the arm of `order.terminal`.
        rows: factors of the arms of `order.by_rows`.
        P: mobility after the last arm, (6, 6) or in factored form.
    """

    centre: Array
    about: list[Contact]
    seen: list[Measurement]
    order: Order
    sums: list[ParallelSum]
    end: list[TerminalSum]
    rows: list[RowSums]
    P: Any


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
        second: arguments of `solve_with_factors`, if they are known in advance; they are processed in the same two
            passes.
    """
    about = each(lambda c: c.about(body.centre, body.centripetal), contacts)
    seen = each(measurement, about, tips)
    order = order_of(seen)
    size = initial_size(body, [seen[i] for i in (*order.parallel, *order.terminal, *order.by_rows)])
    x, w, r = [body.acceleration], [body.wrench], [[m.r] for m in seen]
    if second is not None:
        r = [[*of, more] for of, more in zip(r, each(seen_along, about, seen, second[0]), strict=True)]
        x, w = [*x, np.zeros(6)], [*w, shift_wrench(-body.centre, second[1])]

    parallel, by_rows = ([[of[i] for i in some] for of in (seen, r)] for some in (order.parallel, order.by_rows))
    P = body.mobility.dense() if order.parallel or order.terminal else None
    now = Filter(x, P, sum(len(c.grasp.free) for c in contacts), 1.0)
    (now, size), sums = scan(rigid_arm, (now, size), *parallel)
    if order.terminal:
        now, end, alpha, last = terminal_arm(now, seen[order.terminal[0]], r[order.terminal[0]], size, w)
        s, rows, independent = [load + own for load, own in zip(w, last[0], strict=True)], [], []
    else:
        free = each(factored, [now.P], [sizes_of_rows(size)])[0] if sums else FactoredMobility(body.D, body.w)
        now = now._replace(P=free)
        now, found = scan(lambda now, m, r: arm_by_rows(now, m, r, size, tolerance), now, *by_rows)
        rows, independent = [one[0] for one in found], [one[2] for one in found]
        alpha, end = [x + now.P.apply(load) for x, load in zip(now.x, w, strict=True)], []
        s, last = scan(back_substituted, w, [one[:2] for one in reversed(found)])
    _, first = scan(back_substituted, s, list(reversed(sums)))

    loads = by_grasp(order, first, last)
    wrenches = [each(wrench_at_contact, about, [of_sides[k] for of_sides in loads]) for k in range(len(w))]
    P = now.P if order.terminal else now.P.dense()
    factors = Factors(body.centre, about, seen, order, [u for u, _ in sums], end, rows, now.P)
    return ObjectSolution(
        wrenches=wrenches[0],
        object_acceleration=acceleration_at_C(body.centre, body.centripetal, alpha[0]),
        mobility=symmetric6(P).mobility_shifted(-body.centre).dense(),
        rank=now.rank,
        weakest_pivot=now.weakest,
        independent=independent if len(rows) == len(contacts) else [],
        solve_with_factors=lambda gaps, wrench: solve_with_factors(factors, gaps, wrench),
        second=None if second is None else (wrenches[1], shift_twist(-body.centre, alpha[1])),
    )


def solve_with_factors(factors: Factors, gaps: list[Array], wrench: Array) -> tuple[list[Array], Array]:
    """Return the wrenches and the object acceleration of the chain at rest for another right-hand side, O(l).

    Args:
        factors: the filter's factors.
        gaps: per grasp, (6,) r about the contact point, world axes.
        wrench: (6,) wrench on the object about C, world axes.
    """
    order, end = factors.order, factors.end
    r = each(seen_along, factors.about, factors.seen, gaps)
    w = shift_wrench(-factors.centre, wrench)
    x, sums = scan(passed, np.zeros(6), factors.sums, [r[i] for i in order.parallel])
    if end:
        ((alpha, own),) = each(lambda end, r: end.back(end.forward(x, r, w)[1], NO_COLUMNS), end, [r[i] for i in order.terminal])
        s, last = w + own, [own]
    else:
        x, rows = scan(passed, x, factors.rows, [r[i] for i in order.by_rows])
        alpha = x + factors.P.apply(w)
        s, last = scan(through, w, factors.rows[::-1], rows[::-1])
    _, first = scan(through, s, factors.sums[::-1], sums[::-1])
    return each(wrench_at_contact, factors.about, by_grasp(order, first, last)), shift_twist(-factors.centre, alpha)


def order_of(seen: list[Measurement]) -> Order:
    """Return the order in which the arms are included: parallel sums first."""
    parallel = [i for i, m in enumerate(seen) if m.parallel]
    by_rows = [i for i, m in enumerate(seen) if not m.parallel]
    return Order(parallel, [], by_rows) if by_rows else Order(parallel[:-1], parallel[-1:], [])


def by_grasp(order: Order, first: list[Any], last: list[Any]) -> list[Any]:
    """Return the results of the backward pass in the order of the grasps; in each list the last arm comes first."""
    found = dict(zip([*order.parallel, *order.terminal, *order.by_rows], [*first[::-1], *last[::-1]], strict=True))
    return [found[i] for i in range(len(found))]


Factored = ParallelSum | RowSums
Passed = tuple[Any, list[Any]]  # an arm's factors, and what the way back needs for every right-hand side
NO_COLUMNS = np.zeros(0)


def rigid_arm(carry: tuple[Filter, Array], m: Measurement, r: list[Array]) -> tuple[tuple[Filter, Array], Passed]:
    """Return the filter and the size of P after an arm included by a parallel sum, and its factors."""
    now, size = carry
    included, update = parallel_sum(m.X, now.P, m, size)
    now, kept = after(now, included, update, r)
    return (now, minimum(size, size_at_centre(m.extent))), (update, kept)


def arm_by_rows(
    now: Filter, m: Measurement, r: list[Array], size: Array, tolerance: float
) -> tuple[Filter, tuple[RowSums, list[Any], Array | None]]:
    """Return the filter after an arm included by its rows, its factors, and which rows are independent."""
    included, update = row_sums(
        np.zeros((6, 0)), now.P, m, m.pivot_sizes(size), m.typical_pivots(size), tolerance
    )
    now, kept = after(now, included, update, r)
    return now, (update, kept, included.independent)


def after(now: Filter, included: Included, update: Factored, r: list[Array]) -> tuple[Filter, list[Any]]:
    """Return the filter after an arm, and what the way back needs; r (rows,) of every right-hand side."""
    sides = [passed(x, update, one) for x, one in zip(now.x, r, strict=True)]
    weakest = minimum(now.weakest, included.weakest)
    return Filter([x for x, _ in sides], included.P, now.rank + included.kept, weakest), [nu for _, nu in sides]


def passed(x: Array, update: Factored, r: Array) -> tuple[Array, Any]:
    """Return x after an arm, and what the way back needs."""
    x, _, nu = update.forward(x, r)
    return x, nu


Terminal = tuple[Filter, list[TerminalSum], list[Array], list[list[Array]]]


def terminal_arm(now: Filter, m: Measurement, r: list[Array], size: Array, w: list[Array]) -> Terminal:
    """Return the filter after the terminal arm, its factors, and for every right-hand side alpha(G) and its wrench."""
    ((included, end),) = each(lambda m: terminal_sum(m.X, now.P, m, size), [m])
    (solutions,) = each(
        lambda end, r: [end.back(end.forward(*side)[1], NO_COLUMNS) for side in zip(now.x, r, w, strict=True)],
        [end],
        [r],
    )
    passed = Filter([], included.P, now.rank + included.kept, minimum(now.weakest, included.weakest))
    return passed, [end], [alpha for alpha, _ in solutions], [[own for _, own in solutions]]


def back_substituted(s: list[Array], arm: Passed) -> tuple[list[Array], list[Array]]:
    """Return for every right-hand side the summed wrenches at G of the later arms and this one, and its own."""
    update, kept = arm
    both = [through(one, update, nu) for one, nu in zip(s, kept, strict=True)]
    return [behind for behind, _ in both], [own for _, own in both]


def through(s: Array, update: Factored, nu: Any) -> tuple[Array, Array]:
    """Return the summed wrench at G of the later arms and this one, and its own."""
    from_arm = update.back(s, nu, NO_COLUMNS)
    return s + from_arm, from_arm


def wrench_at_contact(about: Contact, from_arm: Array) -> Array:
    """Return an arm's wrench about its contact point, exactly 0 along the grasp's freedoms, (6,)."""
    return about.transmissible(shift_wrench(-about.offset, from_arm))


def initial_size(body: FreeBody, seen: list[Measurement]) -> Array:
    """Return the size of the object's mobility before the first arm, (3,), for judging pivots; see `size_at_centre`.

    The mobility of a light object is limited to that of the arms, because P is of that size once the arms are included.
    Anchors, which do not move, and bushings, which have no rows, are left out.
    """
    own, seen = own_size(body), [m for m in seen if m.most and m.angular]
    if not seen:
        return own
    least = LEAST_MOBILE * own  # the angular mobility of sliding joints is zero
    most, _ = scan(lambda size, m: (maximum(size, size_at_centre(m.extent)), None), least, seen)
    return minimum(own, most)


def own_size(body: FreeBody) -> Array:
    """Return the size of the object's own mobility, (3,)."""
    turning, moving = block_sizes(body.mobility)
    return array([turning, moving, moving])


def sizes_of_rows(size: Array) -> Array:
    """Return the sizes of the rows of P, (6,)."""
    return np.repeat(size[:2], 3)
