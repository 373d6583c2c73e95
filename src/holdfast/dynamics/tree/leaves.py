"""Leaves: chains of joints that end at one closure and that nothing else needs, included without opening a frame.

The response of a chain at its tip, alpha_f + X beta_base - Lambda f, turns its closure into a measurement of the body
at the other end, as an arm's grasp measures the object (`measurement`). One after the other, the chains at one lone
free body are included by parallel sums if their closures transmit everything, and otherwise by their rows.

If the chain hangs on an open frame z_of, its rows read C z - K X z_of. If the other end is the world, or the root,
whose acceleration is given, the wrench is noted on a frame of the world, which has no mobility.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
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
from holdfast.dynamics.closed.measurement import Measurement, measurement, seen_along, size_at_centre
from holdfast.dynamics.closed.tip_response import BaseResponse, TipResponse
from holdfast.dynamics.tree.belief import Belief, sizes_of_rows
from holdfast.dynamics.tree.forest_motion import ClosureMotion
from holdfast.dynamics.tree.order import ROOT, MeasureLeaf, MeasureLeaves
from holdfast.dynamics.tree.settled import SettledBody
from holdfast.dynamics.tree.steps import (
    Back,
    Closed,
    Inward,
    PartMotion,
    back_close_frame,
    close_frame,
    forward_close_frame,
)
from holdfast.spatial.inertia import NO_INERTIA
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, each, minimum, scan
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench
from holdfast.spatial.symmetric import symmetric6

_NONE = np.zeros(6)


class Leaf(NamedTuple):
    """A leaf before it is included.

    Attributes:
        step: the step.
        contact: its contact, with the point of the body at the other end in place of C.
        seen: its measurement of that body, with X if its base moves.
        joints: its bodies, if it is no limb.
    """

    step: MeasureLeaf
    contact: Contact
    seen: Measurement
    joints: list[SettledBody]


class Leaves(NamedTuple):
    """Leaves that have been included.

    Attributes:
        leaves: the leaves in order: those of parallel sums first.
        frames: the frames that were open, and that of the world if there is one, (None, 6).
        sums: factors of those included by parallel sums.
        end: of the last of them, if the free body leaves with it.
        rows: of those included by their rows.
        closed: the free body's frame if it was left out after them.
        independent: per leaf, which of its rows are independent, if they have a mask; only of those by rows.
    """

    leaves: list[Leaf]
    frames: Mapping[int | None, int]
    sums: list[ParallelSum]
    end: list[TerminalSum]
    rows: list[RowSums]
    closed: Closed | None
    independent: list[Array | None]


class Kept(NamedTuple):
    """What the way back needs of one right-hand side: of every leaf, of the terminal one, and of the free body."""

    sums: list[Any]
    end: Any
    rows: list[Any]
    closed: Array | None


class Passing(NamedTuple):
    """The state while leaves are included one after the other; x and load have one entry per right-hand side."""

    X: Array
    P: Any
    size: Any
    N: Array
    kept: Scalar
    weakest: Scalar
    x: list[Array]
    load: list[Array]


def leaves_of(of: PartMotion, steps: Sequence[MeasureLeaf]) -> dict[int, Leaf]:
    """Return the leaves of a part, by closure."""
    limbs = [step for step in steps if step.closure in of.motion.limbs]
    tips = [of.motion.limbs[step.closure].tip for step in limbs]
    contacts = [contact_of(of.motion.closures[step.closure], step, limb=True) for step in limbs]
    seen = each(measurement, contacts, tips)
    found = {step.closure: Leaf(step, c, m, []) for step, c, m in zip(limbs, contacts, seen, strict=True)}
    return found | {step.closure: chain_of_joints(of, step) for step in steps if step.closure not in found}


def chain_of_joints(of: PartMotion, step: MeasureLeaf) -> Leaf:
    """Return the leaf of joints that are no limb, from their own responses."""
    c = of.motion.closures[step.closure]
    joints, X, w, D = [of.settled[k] for k in step.joints], np.eye(6), np.zeros((6, 0)), []
    for body in joints:
        X, w = body.carried(X), np.hstack([body.carried(w), body.columns])
        D += body.factors.inverse_pivots.tolist()
    X, w = (_shifted(c.l_b if step.is_b else c.l_a, columns) for columns in (X, w))
    base = None if step.of is None else BaseResponse(X, np.zeros((6, 6)), _NONE, NO_INERTIA, _NONE)
    mobility, contact = symmetric6((w * array(D)) @ w.T), contact_of(c, step, limb=False)
    tip = TipResponse(mobility, _NONE, array(D), lambda *_: (_NONE, _NONE), 0.0, base)
    return Leaf(step, contact, measurement(contact, tip), joints)


def contact_of(c: ClosureMotion, step: MeasureLeaf, *, limb: bool) -> Contact:
    """Return the contact of a leaf, about the point of the body at its other end.

    The free acceleration of a limb includes zeta of its end; the other parts of r are the contact's.
    """
    if step.is_b:
        return replace(c.contact, offset=c.l_a, g=_NONE if limb else c.zeta_b, a=c.g + c.zeta_a)
    return replace(c.contact, offset=c.l_b, g=c.g if limb else c.g + c.zeta_a, a=c.zeta_b)


def _shifted(l: Array, columns: Array) -> Array:
    return array([shift_twist(l, column) for column in columns.T]).reshape(-1, 6).T


def right_hand_side(side: Inward, leaf: Leaf) -> Array:
    """Return r of a leaf's measurement, (rows,)."""
    step = leaf.step
    if leaf.joints:
        c, free = side.rhs.closures[step.closure], np.zeros((6, 1))
        for body, k in zip(leaf.joints, step.joints, strict=True):
            free = body.carried(free) + (body.motion.H @ side.nu[k])[:, None]
        still = contact_of(c, step, limb=False)
        gap = shift_twist(c.l_b if step.is_b else c.l_a, free[:, 0]) + still.g - still.a
        return seen_along(leaf.contact, leaf.seen, gap)
    return (
        leaf.seen.r
        if step.closure not in side.rhs.gaps
        else seen_along(leaf.contact, leaf.seen, side.rhs.gaps[step.closure])
    )


def measure_leaves(
    now: Belief, sides: Sequence[Inward], step: MeasureLeaves, of: PartMotion
) -> tuple[Belief, Leaves, list[Kept]]:
    """Include leaves, with right-hand sides; return the state, the factors, and per side what the way back needs."""
    leaves, lone = [of.leaves[one.closure] for one in step.leaves], _at_lone_body(now, step)
    summed = [leaf for leaf in leaves if lone and leaf.seen.parallel and now.dense() is not None]
    others = [leaf for leaf in leaves if not any(leaf is one for one in summed)]
    ending = summed[-1:] if step.closes is not None and not others else []
    summed = summed[: len(summed) - len(ending)]
    first = lone_size(now) if lone else np.zeros(3)
    P = now.dense() if summed or ending else now.factors
    x, load = [side.x for side in sides], [side.on_root for side in sides]
    passing, frames = Passing(now.X, P, first, now.N, now.kept, now.weakest, x, load), dict(now.frames)
    r = [[right_hand_side(side, leaf) for side in sides] for leaf in (*summed, *ending, *others)]
    seen = [_with_columns(leaf.seen, of.width) for leaf in (*summed, *ending)]
    passing, sums = scan(by_sum, passing, seen[: len(summed)], r[: len(summed)])
    rows, end, ends, closed, closes = [], [], [None for _ in sides], None, [None for _ in sides]
    if others:
        if summed:
            (P,) = each(factored, [passing.P], [sizes_of_rows(passing.size)])
            passing = passing._replace(P=P)
        passing, rows, frames = by_rows(passing, others, r[len(summed) :], now, of, lone=lone)
    elif ending:
        passing, end, ends = by_last(
            passing, seen[-1], r[-1], [side.rhs.bodies[step.closes.body].wrench for side in sides]
        )
    now = now._replace(X=passing.X, P=passing.P, N=passing.N, kept=passing.kept, weakest=passing.weakest)
    now = now._replace(size=dict.fromkeys(now.size, passing.size)) if lone else now
    for side, x, load in zip(sides, passing.x, passing.load, strict=True):
        side.x, side.on_root = x, load
    if ending:
        now = now._replace(frames={}, X=now.X[:0], P=FactoredMobility([], []), prior={}, size={})
    elif step.closes is not None:
        now, closed = close_frame(now, step.closes, of)
        closes = [forward_close_frame(side, step.closes, closed) for side in sides]
    order = [*summed, *ending, *others]
    factors = Leaves(
        order, frames, [u for u, _ in sums], end, [u for u, _, _ in rows], closed, [one[2] for one in rows]
    )
    kept = [
        Kept([nus[i] for _, nus in sums], ends[i], [nus[i] for _, nus, _ in rows], closes[i]) for i in range(len(sides))
    ]
    return now, factors, kept


def by_sum(now: Passing, m: Measurement, r: list[Array]) -> tuple[Passing, tuple[ParallelSum, list[Array]]]:
    """Return the state after a leaf included by a parallel sum, its factors, and nu of every right-hand side."""
    included, update = parallel_sum(now.X, now.P, m, now.size)
    now, nus = _after(now, included, update, r)
    return now._replace(size=minimum(now.size, size_at_centre(m.extent))), (update, nus)


def by_last(
    now: Passing, m: Measurement, r: list[Array], w: list[Array]
) -> tuple[Passing, list[TerminalSum], list[Any]]:
    """Return the state after the leaf with which a free body leaves, its factors, and what the way back needs."""
    ((included, end),) = each(lambda m: terminal_sum(now.X, now.P, m, now.size), [m])
    (sides,) = each(lambda end, r: [end.forward(*side) for side in zip(now.x, r, w, strict=True)], [end], [r])
    weakest = minimum(now.weakest, included.weakest)
    passed = now._replace(
        P=included.P,
        N=now.N + included.N,
        kept=now.kept + included.kept,
        weakest=weakest,
        x=[np.zeros(0) for _ in sides],
        load=[load + more for load, (more, _) in zip(now.load, sides, strict=True)],
    )
    return passed, [end], [kept for _, kept in sides]


def by_rows(
    passing: Passing, leaves: list[Leaf], r: list[list[Array]], now: Belief, of: PartMotion, *, lone: bool
) -> tuple[Passing, list[tuple[RowSums, list[Any], Array | None]], dict[int | None, int]]:
    """Return the state after leaves included by their rows, their factors, and the frames that were open."""
    tolerance, size = of.tolerance, passing.size
    if lone:

        def include(now: Passing, m: Measurement, r: list[Array]) -> tuple[Passing, Any]:
            return _by_rows(now, m, r, m.pivot_sizes(size), m.typical_pivots(size), tolerance)

        found = scan(include, passing, [_with_columns(leaf.seen, of.width) for leaf in leaves], r)
        return *found, dict(now.frames)
    frames: dict[int | None, int] = dict(now.frames)
    if any(leaf.step.other in (None, ROOT) for leaf in leaves):
        frames[None] = 6
        passing = _with_world(passing)
    items = [_among(leaf, now, frames, of) for leaf in leaves]

    def include_among(now: Passing, m: Measurement, sizes: Array, r: list[Array]) -> tuple[Passing, Any]:
        return _by_rows(now, m, r, m.own_sizes() + sizes, np.diag(m.R) + sizes / 3.0, tolerance)

    passing, rows = scan(include_among, passing, [m for m, _ in items], [sizes for _, sizes in items], r)
    return (_without_world(passing, len(now.X)) if None in frames else passing), rows, frames


def forward_leaves(side: Inward, step: MeasureLeaves, of: Leaves) -> Kept:
    """Carry another right-hand side through leaves that have been included; return what its way back needs."""
    r = each(lambda leaf: right_hand_side(side, leaf), of.leaves)
    (x, load), sums = scan(_passed, (side.x, side.on_root), of.sums, r[: len(of.sums)])
    if of.end:
        w = side.rhs.bodies[step.closes.body].wrench
        ((more, end),) = each(lambda end, r: end.forward(x, r, w), of.end, r[-1:])
        side.x, side.on_root = np.zeros(0), load + more
        return Kept(sums, end, [], None)
    n = len(x)
    x = concatenate([x, np.zeros(6)]) if None in of.frames else x
    (x, load), rows = scan(_passed, (x, load), of.rows, r[len(of.sums) :])
    side.x, side.on_root = x[:n], load
    return Kept(sums, None, rows, None if of.closed is None else forward_close_frame(side, step.closes, of.closed))


def back_leaves(backs: Sequence[Back], step: MeasureLeaves, of: Leaves, kept: Sequence[Kept]) -> None:
    """Find the wrenches of leaves, for all right-hand sides together."""
    betas, last = [back.beta_root for back in backs], []
    if of.end:
        (found,) = each(
            lambda end, ends: [end.back(one, beta) for one, beta in zip(ends, betas, strict=True)],
            of.end,
            [[one.end for one in kept]],
        )
        s, last = [], [[own for _, own in found]]
        for back, (alpha, own) in zip(backs, found, strict=True):
            back.beta[step.closes.body] = alpha
            s.append(back.rhs.bodies[step.closes.body].wrench + own)
    else:
        for back, one in zip(backs, kept, strict=True):
            if of.closed is not None:
                back_close_frame(back, step.closes, of.closed, one.closed)
            if None in of.frames:
                back.s[None] = _NONE
        s = [back.stacked(of.frames) for back in backs]

    def through(s: list[Array], update: ParallelSum | RowSums, nus: list[Any]) -> tuple[list[Array], list[Array]]:
        own = [update.back(one, nu, beta) for one, nu, beta in zip(s, nus, betas, strict=True)]
        return [one + more for one, more in zip(s, own, strict=True)], own

    s, of_rows = scan(through, s, of.rows[::-1], _by_leaf([one.rows for one in kept])[::-1])
    s, of_sums = scan(through, s, of.sums[::-1], _by_leaf([one.sums for one in kept])[::-1])
    for back, one in zip(backs, s, strict=True):
        back.unstack(of.frames, one)
        back.s.pop(None, None)
    from_leaves = [*of_sums[::-1], *last, *of_rows[::-1]]
    places = [_rows_of(leaf.step.other if leaf.step.other in of.frames else None, of.frames) for leaf in of.leaves]
    contacts = [leaf.contact for leaf in of.leaves]
    for i, back in enumerate(backs):
        found = each(wrench_at_contact, contacts, [of[i][at] for of, at in zip(from_leaves, places, strict=True)])
        for leaf, f in zip(of.leaves, found, strict=True):
            back.wrenches[leaf.step.closure] = -f if leaf.step.is_b else f
            through_joints(back, leaf, f)


def through_joints(back: Back, leaf: Leaf, f: Array) -> None:
    """Let the wrench f of a leaf's end on the other body pass inward through its joints, if they are no limb."""
    if leaf.joints:
        c = back.rhs.closures[leaf.step.closure]
        t = -shift_wrench(c.l_b if leaf.step.is_b else c.l_a, f)
        for k, body in zip(reversed(leaf.step.joints), reversed(leaf.joints), strict=True):
            back.extra[k], t = body.through(t)


def lone_size(now: Belief) -> Array:
    """Return the size of a lone free body's mobility, (3,)."""
    ((_, size),) = now.size.items()
    return size


def _at_lone_body(now: Belief, step: MeasureLeaves) -> bool:
    """Return whether only a free body is open, and all leaves end there, from the root or from the world."""
    alone = len(now.frames) == 1 and [*now.size] == [*now.frames]
    return alone and all(one.of in (None, ROOT) and one.other in now.frames for one in step.leaves)


def _after(
    now: Passing, included: Included, update: ParallelSum | RowSums, r: list[Array]
) -> tuple[Passing, list[Any]]:
    """Return the state after a leaf, and nu of every right-hand side."""
    sides = [update.forward(x, one) for x, one in zip(now.x, r, strict=True)]
    passed = now._replace(
        X=included.X,
        P=included.P,
        N=now.N + included.N,
        kept=now.kept + included.kept,
        weakest=minimum(now.weakest, included.weakest),
        x=[x for x, _, _ in sides],
        load=[load + more for load, (_, more, _) in zip(now.load, sides, strict=True)],
    )
    return passed, [nu for _, _, nu in sides]


def _by_rows(
    now: Passing, m: Measurement, r: list[Array], scale: Array, typical: Array, tolerance: float
) -> tuple[Passing, tuple[RowSums, list[Any], Array | None]]:
    included, update = row_sums(now.X, now.P, m, scale, typical, tolerance)
    now, nus = _after(now, included, update, r)
    return now, (update, nus, included.independent)


def _passed(state: tuple[Array, Array], update: ParallelSum | RowSums, r: Array) -> tuple[tuple[Array, Array], Any]:
    x, more, nu = update.forward(state[0], r)
    return (x, state[1] + more), nu


def _with_columns(m: Measurement, width: int) -> Measurement:
    """Return a measurement with columns for the root, also if the leaf stands in the world."""
    return m if m.X.shape[1] == width else replace(m, X=np.zeros((len(m.r), width)))


def _among(leaf: Leaf, now: Belief, frames: Mapping[int | None, int], of: PartMotion) -> tuple[Measurement, Array]:
    """Return a leaf's rows on all open frames, and the part of the open frames in their sizes (rows,)."""
    m, step = leaf.seen, leaf.step
    ends = [(step.other, m.C), *([] if step.of is None else [(step.of, -m.X)])]
    on, on_root = of.placed(ends)
    sizes = now.sizes_of(on, len(m.r))
    world = [m.C if step.other in (None, ROOT) else 0.0 * m.C] if None in frames else []
    C = np.concatenate([now.coefficients(on, len(m.r)), *world], axis=1)
    return replace(m, C=C, X=-on_root), sizes


def _with_world(now: Passing) -> Passing:
    """Return the state with a frame of the world, which does not move."""
    P = FactoredMobility(now.P.D, [concatenate([w, _NONE]) for w in now.P.w])
    X = np.concatenate([now.X, np.zeros((6, now.X.shape[1]))])
    return now._replace(X=X, P=P, x=[concatenate([x, _NONE]) for x in now.x])


def _without_world(now: Passing, n: int) -> Passing:
    """Return the state without the frame of the world."""
    P = FactoredMobility(now.P.D, [w[:n] for w in now.P.w])
    return now._replace(X=now.X[:n], P=P, x=[x[:n] for x in now.x])


def _by_leaf(of_sides: list[list[Any]]) -> list[list[Any]]:
    """Return per leaf what is given per right-hand side."""
    return [list(one) for one in zip(*of_sides, strict=True)]


def _rows_of(frame: int | None, frames: Mapping[int | None, int]) -> slice:
    start = 0
    for name, size in frames.items():
        if name == frame:
            return slice(start, start + size)
        start += size
    raise KeyError(frame)


def wrench_at_contact(about: Contact, from_leaf: Array) -> Array:
    """Return a leaf's wrench about its contact point, exactly 0 along the grasp's freedoms, (6,)."""
    return about.transmissible(shift_wrench(-about.offset, from_leaf))
