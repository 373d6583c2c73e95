"""The step that includes leaves, one after the other, without opening a frame.

Those at one lone free body are included by parallel sums if their closures transmit everything, and otherwise by their
rows. With the last one, the body leaves.

If the chain hangs on an open frame z_of, its rows read C z - K X z_of. If the other end is the world, or the root,
whose acceleration is given, the wrench is noted on a frame of the world, which has no mobility.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

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
from holdfast.dynamics.closed.measurement import Measurement, size_at_centre
from holdfast.dynamics.tree.belief import Belief, rows_of, sizes_of_rows
from holdfast.dynamics.tree.leaf import (
    LeafMeasurement,
    Noise,
    given_to,
    independent,
    right_hand_side,
    through_joints,
    wrench_at_contact,
)
from holdfast.dynamics.tree.order import ROOT, MeasureLeaves
from holdfast.dynamics.tree.right_hand_sides import Inward, Outward
from holdfast.dynamics.tree.steps import (
    Closed,
    PartMotion,
    StepKind,
    back_close_frame,
    close_frame,
    forward_close_frame,
)
from holdfast.spatial.scalar import Array, Scalar, concatenate, each, minimum, scan

_NONE = np.zeros(6)
WORLD_FRAME = -2  # a frame of the world, on which the wrench of a leaf between open frames and the world is noted


class Leaves(NamedTuple):
    """Leaves that have been included.

    Attributes:
        leaves: the leaves in order: those of parallel sums first.
        apart: as in `PartMotion`.
        frames: the frames that were open, and `WORLD_FRAME` if a leaf ends neither at one of them nor at a free body.
        sums: factors of those included by parallel sums.
        end: of the last of them, if the free body leaves with it.
        rows: of those included by their rows.
        closed: the free body's frame if it was left out after them.
        independent: per leaf, which of its rows are independent, if they have a mask; only of those by rows.
    """

    leaves: list[LeafMeasurement]
    apart: bool
    frames: Mapping[int, int]
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


def measure_leaves(
    now: Belief, sides: Sequence[Inward], step: MeasureLeaves, of: PartMotion
) -> tuple[Belief, Leaves, list[Kept]]:
    """Include leaves, with right-hand sides; return the state, the factors, and per side what the way back needs."""
    leaves, lone = [of.leaves[one.closure] for one in step.leaves], _at_lone_body(now, step)
    summed = [leaf for leaf in leaves if lone and leaf.parallel and now.dense() is not None]
    others = [leaf for leaf in leaves if not any(leaf is one for one in summed)]
    ending = summed[-1:] if step.closes is not None and not others else []
    summed = summed[: len(summed) - len(ending)]
    first = lone_size(now) if lone else np.zeros(3)
    P = now.dense() if summed or ending else now.factors
    x, load = [side.x for side in sides], [side.on_root for side in sides]
    passing, frames = Passing(now.X, P, first, now.N, now.kept, now.weakest, x, load), dict(now.frames)
    r = [[right_hand_side(leaf, *given_to(side, leaf)) for side in sides] for leaf in (*summed, *ending, *others)]
    seen = [_with_columns(leaf.seen, now.width) for leaf in (*summed, *ending)]
    # one leaf finds zeros in the mobility of the free body alone, which a scan would not see
    loop = (_alone if len(summed) == 1 else scan) if of.apart else _in_turn
    passing, sums = loop(by_sum, passing, seen[: len(summed)], r[: len(summed)])
    rows, end, ends, closed, closes = [], [], [None for _ in sides], None, [None for _ in sides]
    if others:
        if summed:
            (P,) = each(factored, [passing.P], [sizes_of_rows(passing.size)])
            passing = passing._replace(P=P)
        passing, rows, frames = by_rows(passing, others, r[len(summed) :], now, of, lone=lone)
    elif ending:
        w = [side.rhs.bodies[step.leaving].wrench for side in sides]
        passing, end, ends = by_last(passing, seen[-1], r[-1], w, apart=of.apart)
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
        order, of.apart, frames, [u for u, _ in sums], end, [u for u, _, _ in rows], closed, [one[2] for one in rows]
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
    now: Passing, m: Measurement, r: list[Array], w: list[Array], *, apart: bool
) -> tuple[Passing, list[TerminalSum], list[Any]]:
    """Return the state after the leaf with which a free body leaves, its factors, and what the way back needs."""
    loop = each if apart else _each_in_turn
    ((included, end),) = loop(lambda m: terminal_sum(now.X, now.P, m, now.size), [m])
    (sides,) = loop(lambda end, r: [end.forward(*side) for side in zip(now.x, r, w, strict=True)], [end], [r])
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
    passing: Passing, leaves: list[LeafMeasurement], r: list[list[Array]], now: Belief, of: PartMotion, *, lone: bool
) -> tuple[Passing, list[tuple[RowSums, list[Any], Array | None]], dict[int, int]]:
    """Return the state after leaves included by their rows, their factors, and the frames that were open."""
    tolerance, size, noises = of.tolerance, passing.size, [leaf.noise for leaf in leaves]
    if lone:

        def include(now: Passing, noise: Noise, m: Measurement, r: list[Array]) -> tuple[Passing, Any]:
            return _by_rows(now, noise, m, r, m.pivot_sizes(size), m.typical_pivots(size), tolerance)

        loop, seen = scan if of.apart else _in_turn, [_with_columns(leaf.seen, now.width) for leaf in leaves]
        return *loop(include, passing, noises, seen, r), dict(now.frames)
    frames: dict[int, int] = dict(now.frames)
    if any(leaf.step.other in (None, ROOT) for leaf in leaves):
        frames[WORLD_FRAME] = 6
        passing = _with_world(passing)
    items = [_among(leaf, now, frames) for leaf in leaves]

    def include_among(now: Passing, noise: Noise, m: Measurement, sizes: Array, r: list[Array]) -> tuple[Passing, Any]:
        return _by_rows(now, noise, m, r, m.own_sizes() + sizes, np.diag(m.R) + sizes / 3.0, tolerance)

    # one or two leaves find zeros in what nothing has measured yet, which a loop would not see
    loop = scan if of.apart and len(leaves) > 2 else _in_turn
    passing, rows = loop(include_among, passing, noises, [m for m, _ in items], [sizes for _, sizes in items], r)
    return (_without_world(passing, len(now.X)) if WORLD_FRAME in frames else passing), rows, frames


def forward_leaves(side: Inward, step: MeasureLeaves, of: Leaves) -> Kept:
    """Carry another right-hand side through leaves that have been included; return what its way back needs."""
    r = each(lambda leaf, given: right_hand_side(leaf, *given), of.leaves, [given_to(side, leaf) for leaf in of.leaves])
    (x, load), sums = scan(_passed, (side.x, side.on_root), of.sums, r[: len(of.sums)])
    if of.end:
        w = side.rhs.bodies[step.leaving].wrench
        ((more, end),) = each(lambda end, r: end.forward(x, r, w), of.end, r[-1:])
        side.x, side.on_root = np.zeros(0), load + more
        return Kept(sums, end, [], None)
    n = len(x)
    x = concatenate([x, np.zeros(6)]) if WORLD_FRAME in of.frames else x
    (x, load), rows = scan(_passed, (x, load), of.rows, r[len(of.sums) :])
    side.x, side.on_root = x[:n], load
    closed = None
    if of.closed is not None and step.closes is not None:
        closed = forward_close_frame(side, step.closes, of.closed)
    return Kept(sums, None, rows, closed)


def back_leaves(backs: Sequence[Outward], step: MeasureLeaves, of: Leaves, kept: Sequence[Kept]) -> None:
    """Find the wrenches of leaves, for all right-hand sides together."""
    betas, last = [back.columns for back in backs], []
    loop = scan if of.apart else _in_turn
    if of.end:
        (found,) = (each if of.apart else _each_in_turn)(
            lambda end, ends: [end.back(one, beta) for one, beta in zip(ends, betas, strict=True)],
            of.end,
            [[one.end for one in kept]],
        )
        s, last = [], [[own for _, own in found]]
        for back, (alpha, own) in zip(backs, found, strict=True):
            back.moves(step.leaving, alpha, alpha)
            s.append(back.rhs.bodies[step.leaving].wrench + own)
    else:
        for back, one in zip(backs, kept, strict=True):
            if of.closed is not None and step.closes is not None and one.closed is not None:
                back_close_frame(back, step.closes, of.closed, one.closed)
            if WORLD_FRAME in of.frames:
                back.s[WORLD_FRAME] = _NONE
        s = [back.stacked(of.frames) for back in backs]

    def through(s: list[Array], update: ParallelSum | RowSums, nus: list[Any]) -> tuple[list[Array], list[Array]]:
        own = [update.back(one, nu, beta) for one, nu, beta in zip(s, nus, betas, strict=True)]
        return [one + more for one, more in zip(s, own, strict=True)], own

    s, of_rows = loop(through, s, of.rows[::-1], _by_leaf([one.rows for one in kept])[::-1])
    s, of_sums = loop(through, s, of.sums[::-1], _by_leaf([one.sums for one in kept])[::-1])
    for back, one in zip(backs, s, strict=True):
        back.unstack(of.frames, one)
        back.s.pop(WORLD_FRAME, None)
    from_leaves = [*of_sums[::-1], *last, *of_rows[::-1]]
    ends = [leaf.step.other if leaf.step.other in of.frames else WORLD_FRAME for leaf in of.leaves]
    places = [rows_of(of.frames, end) for end in ends]
    contacts = [leaf.contact for leaf in of.leaves]
    for i, back in enumerate(backs):
        found = each(wrench_at_contact, contacts, [of[i][at] for of, at in zip(from_leaves, places, strict=True)])
        for leaf, f in zip(of.leaves, found, strict=True):
            back.wrenches[leaf.step.closure] = -f if leaf.step.is_b else f
            through_joints(back, leaf, f)


def _alone(f: Callable[..., Any], carry: Any, *items: Iterable[Any]) -> tuple[Any, list[Any]]:
    """Return what a scan of one item would; constants in the carry stay constants."""
    ((carry, found),) = each(lambda *item: f(carry, *item), *items)
    return carry, [found]


def _in_turn(f: Callable[..., Any], carry: Any, *items: Iterable[Any]) -> tuple[Any, list[Any]]:
    """Return what `scan` does, traced as part of what surrounds it."""
    found = []
    for row in zip(*items, strict=True):
        carry, one = f(carry, *row)
        found.append(one)
    return carry, found


def _each_in_turn(f: Callable[..., Any], *items: Iterable[Any]) -> list[Any]:
    """Return what `each` does, likewise."""
    return [f(*row) for row in zip(*items, strict=True)]


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
    now: Passing,
    noise: Noise,
    m: Measurement,
    r: list[Array],
    scale: Array,
    typical: Array,
    tolerance: float,
) -> tuple[Passing, tuple[RowSums, list[Any], Array | None]]:
    found = independent(noise, m, scale, typical)
    included, update = row_sums(now.X, now.P, m, scale, typical, tolerance, found)
    now, nus = _after(now, included, update, r)
    return now, (update, nus, included.independent)


def _passed(state: tuple[Array, Array], update: ParallelSum | RowSums, r: Array) -> tuple[tuple[Array, Array], Any]:
    x, more, nu = update.forward(state[0], r)
    return (x, state[1] + more), nu


def _with_columns(m: Measurement, width: int) -> Measurement:
    """Return a measurement with columns for the root, also if the leaf stands in the world."""
    return m if m.X.shape[1] == width else replace(m, X=np.zeros((len(m.r), width)))


def _among(leaf: LeafMeasurement, now: Belief, frames: Mapping[int, int]) -> tuple[Measurement, Array]:
    """Return a leaf's rows on all open frames, and the part of the open frames in their sizes (rows,)."""
    m, step = leaf.seen, leaf.step
    ends = [(step.other, m.C), *([] if step.of is None else [(step.of, -m.X)])]
    on, on_root = now.placed(ends)
    sizes = now.sizes_of(on, len(m.r))
    world = [m.C if step.other in (None, ROOT) else 0.0 * m.C] if WORLD_FRAME in frames else []
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


LEAF_STEPS: dict[type, StepKind] = {MeasureLeaves: StepKind(measure_leaves, forward_leaves, back_leaves)}
