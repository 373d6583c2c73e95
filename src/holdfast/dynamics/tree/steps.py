"""The steps of the elimination of a part: what each does to the state, to a right-hand side, and on the way back.

`factor` changes the `Belief`, `forward` carries a right-hand side x through the same step, and `back` takes it in
reverse: s holds by frame the wrench on it of everything that was included after the step (docs/theory/tree.md):

    AddFree        z gains (x_b, X = 0, P_b), independent                s_b leaves
    OpenFrame      z gains a copy of a frame, X = 1 at the root          s_of += s_f
    MoveFrame      f <- psi^T f + H nu,  P += H D^-1 H^T                 s_f <- phi (s_f - G t), t = H^T s_f
    Measure        `with_measurement`                                    lambda = nu + E beta - gain s, s += c^T lambda
    CloseFrame     x += P_f w,  n -= X_f^T w;  z forgets f               s_f = w,  beta_f = x + X beta + P s

with the external wrench w of a free body. Chains of joints that end at one closure are in `leaves`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.closed.factored_mobility import FactoredMobility
from holdfast.dynamics.closed.measurement import size_at_centre
from holdfast.dynamics.tree.belief import Belief, MeasuredRows, sizes_of_rows, with_measurement
from holdfast.dynamics.tree.branches import ForestPart
from holdfast.dynamics.tree.forest_motion import ForestMotion
from holdfast.dynamics.tree.order import (
    ROOT,
    AddFree,
    CloseFrame,
    Couple,
    Measure,
    MoveFrame,
    OpenFrame,
)
from holdfast.dynamics.tree.right_hand_sides import Inward, Outward
from holdfast.dynamics.tree.settled import SettledBody, Settling
from holdfast.spatial.linalg import RANK_TOLERANCE
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, maximum, minimum, scan

LEAST_MOBILE = 1e-16  # relative to a free body's own mobility


class PartMotion(NamedTuple):
    """What the steps of a part need.

    Attributes:
        motion: the forest's motion.
        settling: its bodies; those on which the part's steps act have settled.
        part: the part.
        tolerance: relative size of a pivot that counts as zero.
        leaves: its leaves, by closure.
        apart: whether machine code has the updates of leaves as functions of their own.
    """

    motion: ForestMotion
    settling: Settling
    part: ForestPart
    tolerance: float = RANK_TOLERANCE
    leaves: Mapping[int, Any] = MappingProxyType({})
    apart: bool = True

    @property
    def settled(self) -> Mapping[int, SettledBody]:
        """The bodies that have settled."""
        return self.settling.bodies


def add_free(now: Belief, step: AddFree, of: PartMotion) -> tuple[Belief, SettledBody]:
    """Add a free body. A light one sets no scale: its mobility counts as at most that of what may hold it."""
    body = of.settled[step.body]
    untouched = body.untouched
    own = size_of(untouched.dense)
    joints = [of.settled[k] for k in of.part.members if k in of.settled and not of.settled[k].motion.floats]
    seen = [leaf.seen for leaf in of.leaves.values() if leaf.seen.most and leaf.seen.angular]
    sizes = [*(size_at_centre(m.extent) for m in seen), *(size_of(joint.mobility) for joint in joints)]
    # the angular mobility of sliding joints is zero
    most, _ = scan(lambda most, size: (maximum(most, size), None), LEAST_MOBILE * own, sizes)
    size = minimum(own, most) if sizes else own
    prior = np.diag(sizes_of_rows(size) / 3.0)
    X, sizes = np.zeros((6, now.width)), {**now.size, step.frame: size}
    if not now.frames:
        return now._replace(frames={step.frame: 6}, X=X, P=untouched, prior={step.frame: prior}, size=sizes), body
    now = now.with_frame(step.frame, X, np.zeros((6, len(now.factors.D))), prior)._replace(size=sizes)
    return now.plus(array(untouched.factors.D), {step.frame: array(untouched.factors.w).T}), body


def forward_add_free(side: Inward, step: AddFree, body: SettledBody) -> None:
    """Add the acceleration of a free body without forces."""
    side.x = concatenate([side.x, side.nu[step.body]])


def back_add_free(back: Outward, step: AddFree, body: SettledBody, kept: Any) -> None:
    """Leave out a free body."""
    del back.s[step.frame]


class Copied(NamedTuple):
    """Where a frame has been copied from: the rows of another one; None for the root and the world."""

    at: slice | None


def open_frame(now: Belief, step: OpenFrame, of: PartMotion) -> tuple[Belief, Copied]:
    """Open a frame as a copy."""
    if step.of is not None and step.of != ROOT:
        at = now.slice_of(step.of)
        return now.with_frame(step.frame, now.X[at], now.factors_at(step.of), now.prior[step.of]), Copied(at)
    X = now.root if step.of == ROOT else np.zeros((6, now.width))
    return now.with_frame(step.frame, X, np.zeros((6, len(now.factors.D))), np.zeros((6, 6))), Copied(None)


def forward_open_frame(side: Inward, step: OpenFrame, of: Copied) -> None:
    """Copy the acceleration of a frame."""
    side.x = concatenate([side.x, np.zeros(6) if of.at is None else side.x[of.at]])


def back_open_frame(back: Outward, step: OpenFrame, of: Copied, kept: Any) -> None:
    """Return a copy's wrench to the frame that was copied."""
    s = back.s.pop(step.frame)
    if step.of is not None and step.of != ROOT:
        back.s[step.of] = back.s[step.of] + s


class Moved(NamedTuple):
    """The joint over which a frame has moved, and the frame's rows."""

    body: SettledBody
    at: slice


def move_frame(now: Belief, step: MoveFrame, of: PartMotion) -> tuple[Belief, Moved]:
    """Move a frame outward over a joint, whose accelerations may be noted as numbers of their own."""
    body, at = of.settled[step.body], now.slice_of(step.frame)
    X, w, prior = now.X[at], now.factors_at(step.frame), now.prior[step.frame]
    columns = {step.frame: body.columns}
    if step.note is not None:  # q = nu - G^T phi^T f
        felt = [_of_joint(body, part) for part in (X, w, prior)]
        noise = body.per_innovation()
        columns[step.note] = noise
        own = _of_joint(body, felt[2].T) + (noise * body.factors.inverse_pivots) @ noise.T
        now = now.with_frame(step.note, felt[0], felt[1], own)
    moved = body.carried(body.carried(prior).T) + body.mobility
    now = now.with_rows(step.frame, body.carried(X), body.carried(w), moved)
    return now.plus(body.factors.inverse_pivots, columns), Moved(body, at)


def forward_move_frame(side: Inward, step: MoveFrame, of: Moved) -> None:
    """Move the acceleration of a frame outward."""
    body, x, nu = of.body, side.x[of.at][:, None], side.nu[step.body]
    moved = body.carried(x)[:, 0] + body.motion.H @ nu
    noted = np.zeros(0) if step.note is None else nu + _of_joint(body, x)[:, 0]
    side.x = concatenate([side.x[: of.at.start], moved, side.x[of.at.stop :], noted])


def back_move_frame(back: Outward, step: MoveFrame, of: Moved, kept: Any) -> None:
    """Move the wrench on a frame inward over a joint."""
    noted = 0.0 if step.note is None else back.s.pop(step.note)
    back.extra[step.body], back.s[step.frame] = of.body.through(back.s[step.frame], noted)


class Imposed(NamedTuple):
    """The rows of a closure or a coupling that have been imposed, and the frames that were open."""

    frames: Mapping[int, int]
    rows: MeasuredRows


def measure(now: Belief, step: Measure, of: PartMotion) -> tuple[Belief, Imposed]:
    """Impose a closure between open frames, the root and the world."""
    c = of.motion.closures[step.closure]
    on, on_root = now.placed([(step.a, c.on_a), (step.b, c.on_b)])
    then, rows = with_measurement(now, on, on_root, c.K, of.tolerance)
    return then, Imposed(now.frames, rows)


def forward_measure(side: Inward, step: Measure, of: Imposed) -> list[Scalar]:
    """Impose a closure's right-hand side."""
    return _imposed(side, of, side.rhs.closures[step.closure].r)


def back_measure(back: Outward, step: Measure, of: Imposed, nus: list[Scalar]) -> None:
    """Find the wrench of a closure."""
    s, back.wrenches[step.closure] = of.rows.back(back.stacked(of.frames), nus, back.columns)
    back.unstack(of.frames, s)


def couple(now: Belief, step: Couple, of: PartMotion) -> tuple[Belief, Imposed]:
    """Impose a coupling between noted accelerations."""
    frames, on = dict(step.noted), {}
    for body, component, coefficient in of.motion.couplings[step.coupling]:
        frame = frames[body]
        row = coefficient * np.eye(now.frames[frame])[component][None]
        on[frame] = on.get(frame, 0.0) + row
    then, rows = with_measurement(now, on, np.zeros((1, now.width)), np.ones((1, 1)), of.tolerance)
    return then, Imposed(now.frames, rows)


def forward_couple(side: Inward, step: Couple, of: Imposed) -> list[Scalar]:
    """Impose a coupling's right-hand side."""
    return _imposed(side, of, array([side.rhs.coupled[step.coupling]]))


def back_couple(back: Outward, step: Couple, of: Imposed, nus: list[Scalar]) -> None:
    """Find the multiplier of a coupling."""
    s, multiplier = of.rows.back(back.stacked(of.frames), nus, back.columns)
    back.multipliers[step.coupling] = multiplier[0]
    back.unstack(of.frames, s)


class Closed(NamedTuple):
    """A frame that has been left out.

    Attributes:
        frames: the frames that were open.
        at: its rows.
        X: (size, c) its response to the root.
        P: mobility of the open frames; without factors if it has not stayed at a free body.
    """

    frames: Mapping[int, int]
    at: slice
    X: Array
    P: FactoredMobility


def close_frame(now: Belief, step: CloseFrame, of: PartMotion) -> tuple[Belief, Closed]:
    """Leave out a frame; on a free body, its external wrench acts before."""
    at, P = now.slice_of(step.frame), FactoredMobility([], []) if step.body is None else now.factors
    return now.without(step.frame), Closed(now.frames, at, now.X[at], P)


def forward_close_frame(side: Inward, step: CloseFrame, of: Closed) -> Array:
    """Let the external wrench of a free body act, and leave out its frame; return its acceleration before."""
    x, own = side.x, side.x[of.at]
    if step.body is not None:
        w = side.rhs.bodies[step.body].wrench
        x, side.on_root = x + of.P.apply(w, at=of.at), side.on_root - of.X.T @ w
    side.x = concatenate([x[: of.at.start], x[of.at.stop :]])
    return own


def back_close_frame(back: Outward, step: CloseFrame, of: Closed, own: Array) -> None:
    """Bring back a frame, with the wrench of a free body on it, whose acceleration is now known."""
    if step.body is None:
        back.s[step.frame] = np.zeros(len(own))
        return
    back.s[step.frame] = back.rhs.bodies[step.body].wrench
    acceleration = own + of.X @ back.columns + of.P.apply(back.stacked(of.frames), to=of.at)
    back.moves(step.body, acceleration, acceleration)


class StepKind(NamedTuple):
    """What a kind of step does.

    Attributes:
        include: to the state and to right-hand sides, together; it returns the state, the step's factors, and per side
            what its way back needs.
        forward: to another right-hand side, given the factors; it returns what its way back needs.
        back: on the way back, to all right-hand sides together.
    """

    include: Callable[..., tuple[Belief, Any, list[Any]]]
    forward: Callable[..., Any]
    back: Callable[..., None]


def one_by_one(
    factor: Callable[..., tuple[Belief, Any]], forward: Callable[..., Any], back: Callable[..., None]
) -> StepKind:
    """Return a kind of step whose right-hand sides do not matter to the state, nor to each other."""

    def include(now: Belief, sides: Sequence[Inward], step: Any, of: PartMotion) -> tuple[Belief, Any, list[Any]]:
        then, factors = factor(now, step, of)
        return then, factors, [forward(side, step, factors) for side in sides]

    def back_all(backs: Sequence[Outward], step: Any, factors: Any, kept: Sequence[Any]) -> None:
        for one, of_side in zip(backs, kept, strict=True):
            back(one, step, factors, of_side)

    return StepKind(include, forward, back_all)


FRAME_STEPS: dict[type, StepKind] = {
    AddFree: one_by_one(add_free, forward_add_free, back_add_free),
    OpenFrame: one_by_one(open_frame, forward_open_frame, back_open_frame),
    MoveFrame: one_by_one(move_frame, forward_move_frame, back_move_frame),
    Measure: one_by_one(measure, forward_measure, back_measure),
    Couple: one_by_one(couple, forward_couple, back_couple),
    CloseFrame: one_by_one(close_frame, forward_close_frame, back_close_frame),
}


def size_of(mobility: Array) -> Array:
    """Return the sizes of a mobility (6, 6), (3,): angular, and twice linear; see `size_at_centre`."""
    turning, moving = np.trace(mobility[:3, :3]), np.trace(mobility[3:, 3:])
    return array([turning, moving, moving])


def _imposed(side: Inward, of: Imposed, r: Array) -> list[Scalar]:
    """Impose right-hand sides r (rows,) of rows; return what the way back needs."""
    side.x, more, nus = of.rows.sums.forward(side.x, r)
    side.on_root = side.on_root + more
    return nus


def _of_joint(body: SettledBody, x: Array) -> Array:
    """Return -G^T phi^T x, (m, columns), the accelerations of a joint due to those of the parent."""
    return -(body.G.T @ body.moved(x))
