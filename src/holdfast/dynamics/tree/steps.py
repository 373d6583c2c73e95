"""The steps of the elimination of a part, each in a forward function and one for the way back.

Forward, a step changes the `Belief`. Back, s holds by frame the wrench on it of everything that was included after the
step; the reverse of a step takes s to what it was before (docs/theory/tree.md):

    AddFree       z gains (x_b, X = 0, P_b), independent                s_b leaves
    OpenFrame     z gains a copy of a frame, X = 1 at the root          s_of += s_f
    MoveFrame     f <- psi^T f + H nu,  P += H D^-1 H^T                 s_f <- phi (s_f - G t), t = H^T s_f
    Measure       `with_measurement`                                    lambda = nu [1 | beta] - gain s, s += c^T lambda
    CloseFrame    x += P_f w,  n -= X_f^T w;  z forgets f               s_f = w,  beta_f = x + X beta + P s

with the external wrench w of a free body. A leaf measures at the end of a chain that is never part of z; its mobility
is the noise of the rows, which are made independent first.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.tree.belief import Belief, MeasuredRow, Rows, first_by, with_measurement
from holdfast.dynamics.tree.forest_motion import ForestMotion
from holdfast.dynamics.tree.order import (
    ROOT,
    AddFree,
    CloseFrame,
    Couple,
    ForestPart,
    Measure,
    MeasureLeaf,
    MoveFrame,
    OpenFrame,
)
from holdfast.dynamics.tree.settled import SettledBody
from holdfast.spatial.scalar import Array, array, concatenate, maximum, minimum, where
from holdfast.spatial.vector import outer

NEGLIGIBLE_NOISE = 1e-26  # the square of a row of factors that is only rounding, relative to its size


class PartMotion(NamedTuple):
    """What the steps of a part need.

    Attributes:
        motion: the forest's motion.
        settled: its settled bodies, by index.
        part: the part.
        width: number c of components of the root's acceleration, 0 if the root is the world.
    """

    motion: ForestMotion
    settled: Mapping[int, SettledBody]
    part: ForestPart
    width: int

    def known(self, root: bool) -> Array:
        """Return [0 | X] of the root, or of the world, (6, 1 + c)."""
        return np.column_stack([np.zeros(6), np.eye(6)]) if root else np.zeros((6, 1 + self.width))


@dataclass
class Back:
    """The way back through the steps of a part.

    Attributes:
        one: (1 + c,) [1 | beta of the root].
        s: by frame, the wrench on it.
        extra: by body, the joint accelerations that forces within the part add.
        beta: by free body, its acceleration.
        wrenches: by closure, f about its contact point.
        multipliers: by coupling, lambda.
    """

    one: Array
    s: dict[int, Array] = field(default_factory=dict)
    extra: dict[int, Array] = field(default_factory=dict)
    beta: dict[int, Array] = field(default_factory=dict)
    wrenches: dict[int, Array] = field(default_factory=dict)
    multipliers: dict[int, Array] = field(default_factory=dict)

    def through_rows(self, frames: Mapping[int, int], rows: Sequence[MeasuredRow]) -> Array:
        """Return the wrench, or multiplier, of measured rows, (k,), after adding it to s."""
        s, total = self.stacked(frames), np.zeros(len(rows[0].k))
        for row in reversed(rows):
            force = row.nu @ self.one - row.gain @ s
            s, total = s + force * row.c, total + force * row.k
        self.unstack(frames, s)
        return total

    def stacked(self, frames: Mapping[int, int]) -> Array:
        """Return s as one vector (n,)."""
        return concatenate([self.s[name] for name in frames])

    def unstack(self, frames: Mapping[int, int], s: Array) -> None:
        """Put s from one vector (n,)."""
        start = 0
        for name, size in frames.items():
            self.s[name] = s[start : start + size]
            start += size


def add_free(now: Belief, step: AddFree, of: PartMotion) -> tuple[Belief, Any]:
    """Add a free body. A light one sets no scale: its mobility counts as at most that of a joint of the part."""
    body = of.settled[step.body]
    own, joints = body.mobility, [of.settled[k] for k in of.part.members if not of.settled[k].motion.floats]
    most = reduce(maximum, [np.trace(joint.mobility) for joint in joints], 0.0)
    cap = where(most > 0.0, minimum(1.0, most / np.trace(own)), 1.0)
    x = np.column_stack([body.nu, np.zeros((6, of.width))])
    now = now.with_frame(step.frame, x, np.zeros((6, len(now.P.D))), cap * own)
    return now.plus(body.factors.inverse_pivots, {step.frame: body.columns}), None


def back_add_free(back: Back, step: AddFree, kept: Any, of: PartMotion) -> None:
    """Leave out a free body."""
    del back.s[step.frame]


def open_frame(now: Belief, step: OpenFrame, of: PartMotion) -> tuple[Belief, Any]:
    """Open a frame as a copy."""
    if step.of is not None and step.of != ROOT:
        x, w = now.x[now.slice_of(step.of)], now.factors_at(step.of)
        return now.with_frame(step.frame, x, w, now.prior[step.of]), None
    x = of.known(step.of == ROOT)
    return now.with_frame(step.frame, x, np.zeros((6, len(now.P.D))), np.zeros((6, 6))), None


def back_open_frame(back: Back, step: OpenFrame, kept: Any, of: PartMotion) -> None:
    """Return a copy's wrench to the frame that was copied."""
    s = back.s.pop(step.frame)
    if step.of is not None and step.of != ROOT:
        back.s[step.of] = back.s[step.of] + s


def move_frame(now: Belief, step: MoveFrame, of: PartMotion) -> tuple[Belief, Any]:
    """Move a frame outward over a joint, whose accelerations may be noted as numbers of their own."""
    body = of.settled[step.body]
    x, w, prior = now.x[now.slice_of(step.frame)], now.factors_at(step.frame), now.prior[step.frame]
    columns = {step.frame: body.columns}
    moved = _with_constant(body.carried(x), body.motion.H @ body.nu)
    if step.note is not None:  # q = nu - G^T phi^T f
        felt = [_of_joint(body, part) for part in (x, w, prior)]
        noise = body.per_innovation()
        columns[step.note] = noise
        own = _of_joint(body, felt[2].T) + (noise * body.factors.inverse_pivots) @ noise.T
        now = now.with_frame(step.note, _with_constant(felt[0], body.nu), felt[1], own)
    now = now.with_rows(step.frame, moved, body.carried(w), body.carried(body.carried(prior).T) + body.mobility)
    return now.plus(body.factors.inverse_pivots, columns), None


def back_move_frame(back: Back, step: MoveFrame, kept: Any, of: PartMotion) -> None:
    """Move the wrench on a frame inward over a joint."""
    noted = 0.0 if step.note is None else back.s.pop(step.note)
    back.extra[step.body], back.s[step.frame] = of.settled[step.body].through(back.s[step.frame], noted)


def measure(now: Belief, step: Measure, of: PartMotion) -> tuple[Belief, Any]:
    """Impose a closure between open frames, the root and the world."""
    c = of.motion.closures[step.closure]
    on, on_root = _placed([(step.a, c.on_a), (step.b, c.on_b)], of)
    none = np.zeros(len(c.K))
    then, rows = with_measurement(now, Rows(on, np.column_stack([c.r, -on_root]), c.K, none, none))
    return then, (now.frames, rows)


def back_measure(back: Back, step: Measure, kept: Any, of: PartMotion) -> None:
    """Find the wrench of a closure."""
    back.wrenches[step.closure] = back.through_rows(*kept)


def couple(now: Belief, step: Couple, of: PartMotion) -> tuple[Belief, Any]:
    """Impose a coupling between noted accelerations."""
    frames, on = dict(step.noted), {}
    for body, component, coefficient in of.motion.forest.couplings[step.coupling].terms:
        frame = frames[body]
        row = coefficient * np.eye(now.frames[frame])[component][None]
        on[frame] = on.get(frame, 0.0) + row
    none = np.zeros(1)
    e = concatenate([[of.motion.coupled[step.coupling]], np.zeros(of.width)])[None]
    then, rows = with_measurement(now, Rows(on, e, np.ones((1, 1)), none, none))
    return then, (now.frames, rows)


def back_couple(back: Back, step: Couple, kept: Any, of: PartMotion) -> None:
    """Find the multiplier of a coupling."""
    back.multipliers[step.coupling] = back.through_rows(*kept)[0]


def measure_leaf(now: Belief, step: MeasureLeaf, of: PartMotion) -> tuple[Belief, Any]:
    """Impose a closure at the end of a chain, whose mobility sum D w w^T is the noise of the rows."""
    c = of.motion.closures[step.closure]
    own, others = (c.on_b, c.on_a) if step.is_b else (c.on_a, c.on_b)
    X, mean, w, D = np.eye(6), np.zeros((6, 1)), np.zeros((6, 0)), []
    for k in step.joints:
        body = of.settled[k]
        X, mean = body.carried(X), body.carried(mean) + (body.motion.H @ body.nu)[:, None]
        w = np.hstack([body.carried(w), body.columns])
        D += body.factors.inverse_pivots.tolist()
    weights = array(D)
    on, on_root = _placed([(step.of, own @ X), (step.other, others)], of)
    variances = (w * w) @ weights
    own_size = np.zeros(len(own))
    for part in (slice(0, 3), slice(3, 6)):
        own_size = own_size + (own[:, part] * own[:, part]).sum(axis=1) * variances[part].sum()
    rows = Rows(on, np.column_stack([c.r - own @ mean[:, 0], -on_root]), c.K, np.zeros(len(own)), own_size)
    then, found = with_measurement(now, independent(rows, own @ w, weights))
    return then, (now.frames, found)


def back_measure_leaf(back: Back, step: MeasureLeaf, kept: Any, of: PartMotion) -> None:
    """Find the wrench of a closure, and let it pass inward through the chain."""
    f = back.wrenches[step.closure] = back.through_rows(*kept)
    t = _on_end(of.motion, step, f)
    for k in reversed(step.joints):
        back.extra[k], t = of.settled[k].through(t)


def close_frame(now: Belief, step: CloseFrame, of: PartMotion) -> tuple[Belief, Any]:
    """Leave out a frame, after the external wrench of a free body has acted."""
    if step.body is None:
        return now.without(step.frame), now.frames
    w, x, P = of.motion.bodies[step.body].wrench, now.x[now.slice_of(step.frame)], now.mobility_of(step.frame)
    pushed = now._replace(
        x=_with_constant(now.x, w @ P), on_root=now.on_root - _with_constant(0.0 * now.on_root, x[:, 1:].T @ w)
    )
    return pushed.without(step.frame), (now.frames, x, P, w)


def back_close_frame(back: Back, step: CloseFrame, kept: Any, of: PartMotion) -> None:
    """Bring back a frame, with the wrench of a free body on it, whose acceleration is now known."""
    if step.body is None:
        back.s[step.frame] = np.zeros(kept[step.frame])
        return
    frames, x, P, w = kept
    back.s[step.frame] = w
    back.beta[step.body] = x @ back.one + P @ back.stacked(frames)


STEPS: dict[type, tuple[Callable[..., tuple[Belief, Any]], Callable[..., None]]] = {
    AddFree: (add_free, back_add_free),
    OpenFrame: (open_frame, back_open_frame),
    MoveFrame: (move_frame, back_move_frame),
    Measure: (measure, back_measure),
    MeasureLeaf: (measure_leaf, back_measure_leaf),
    Couple: (couple, back_couple),
    CloseFrame: (close_frame, back_close_frame),
}


def independent(rows: Rows, Z: Array, D: Array) -> Rows:
    """Return rows with independent noise: Z D Z^T = L diag(d) L^T by weighted Gram-Schmidt, and all parts times L^-1.

    The row with the largest remaining noise, relative to its size, comes first, so that the entries of L are small.
    Rows beyond the number of factors have no noise: what remains of it is rounding.

    Args:
        rows: the rows, without noise.
        Z: (rows, factors) the factors of their noise.
        D: (factors,) their weights.
    """
    count, factors, names = len(Z), Z.shape[1], list(rows.on)
    table = np.column_stack([Z, *rows.on.values(), rows.e, rows.K, rows.own_size])
    width = table.shape[1] - 1
    done, noise = [], []
    for j in range(count):
        variance = (table[:, :factors] * table[:, :factors]) @ D
        row, table = first_by(variance, table)
        of = (row[:factors] * row[:factors]) @ D
        alive = of > NEGLIGIBLE_NOISE * row[-1] if j < factors else np.False_
        inverse = where(alive, 1.0 / where(alive, of, 1.0), 0.0)
        noise.append(where(alive, of, 0.0))
        L = inverse * (table[:, :factors] @ (D * row[:factors]))
        table = np.column_stack([table[:, :width] - outer(L, row[:width]), table[:, -1]])
        done.append(row)
    whole, start, on = array(done), factors, {}
    for name in names:
        on[name] = whole[:, start : start + rows.on[name].shape[1]]
        start += rows.on[name].shape[1]
    middle = start + rows.e.shape[1]
    return Rows(on, whole[:, start:middle], whole[:, middle:-1], array(noise), whole[:, -1])


def _on_end(motion: ForestMotion, step: MeasureLeaf, f: Array) -> Array:
    """Return the wrench of a closure on the body at the end of a leaf, about its point, (6,)."""
    c = motion.closures[step.closure]
    own = c.on_b if step.is_b else c.on_a
    return own.T @ (c.K @ f)


def _placed(ends: Sequence[tuple[int | None, Array]], of: PartMotion) -> tuple[dict[int, Array], Array]:
    """Return rows by open frame, and those on the root's acceleration (rows, c)."""
    on: dict[int, Array] = {}
    on_root = np.zeros((len(ends[0][1]), of.width))
    for frame, rows in ends:
        if frame == ROOT:
            on_root = on_root + rows
        elif frame is not None:
            on[frame] = on[frame] + rows if frame in on else rows
    return on, on_root


def _of_joint(body: SettledBody, x: Array) -> Array:
    """Return -G^T phi^T x, (m, columns), the accelerations of a joint due to those of the parent."""
    return -(body.G.T @ body.moved(x))


def _with_constant(x: Array, more: Array) -> Array:
    """Return [x | X] with x + more."""
    return np.column_stack([x[:, 0] + more, x[:, 1:]])
