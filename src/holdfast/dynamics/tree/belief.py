"""The state of the elimination of a part: accelerations of open frames, and the mobility with which they are known.

The acceleration of the open frames for given forces is x + X beta + P s, where beta is the acceleration of the part's
root, and s are the wrenches of what has not been included yet. P = sum D w w^T remains in factors, or is a matrix while
a lone free body is only measured by parallel sums (`filter_updates`); nothing is subtracted from it. What the measured
rows say about beta is a sum of squares at the root:

    row c z + c_root beta = r:    e = [r - c x | -c_root - c X],  sigma = c P c^T,  k = P c^T
    [x | X] += k e / sigma,    [n | N] += e_beta^T e / sigma,    D, w by Bierman's update

X, P and N do not depend on the right-hand side; x and n are found by `Inward` (`right_hand_sides`), one for each.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.factored_mobility import FactoredMobility, factored
from holdfast.dynamics.closed.filter_updates import RowSums, included_row
from holdfast.dynamics.tree.order import ROOT
from holdfast.spatial.linalg import RANK_TOLERANCE
from holdfast.spatial.scalar import Array, Scalar, array, maximum, minimum, select, where
from holdfast.spatial.vector import outer


class MeasuredRows(NamedTuple):
    """The rows of a closure or a coupling, in the order in which they have been included.

    Attributes:
        sums: the rows.
        K: per row, (k,) wrench, or multiplier, per unit of lambda.
    """

    sums: RowSums
    K: list[Array]

    def back(self, s: Array, nus: list[Scalar], beta: Array) -> tuple[Array, Array]:
        """Return s with the rows' wrenches, and their wrench or multiplier (k,)."""
        from_rows, forces = self.sums.forces(s, nus, beta)
        along = [force * K for force, K in zip(reversed(forces), self.K, strict=True)]
        return s + from_rows, sum(along, start=np.zeros(len(self.K[0])))


class Untouched(NamedTuple):
    """The mobility of a free body that nothing has measured yet, in both forms."""

    dense: Array
    factors: FactoredMobility


class Belief(NamedTuple):
    """Open frames at one moment.

    Attributes:
        frames: number of rows by open frame, the oldest first.
        root: (6, c) acceleration of the root per column: the identity, or of joint rates; (6, 0) if it is the world.
        X: (n, c).
        P: mobility (n, n), in factors, as a matrix, or untouched.
        prior: by frame, its mobility without any measurement, (size, size), from which sizes of pivots follow.
        size: by free body's frame, (3,) sizes of its mobility as of `size_at_centre`, which parallel sums reduce.
        N: (c, c) inertia at the root.
        kept: number of independent rows.
        weakest: the smallest pivot of these rows, relative to its size.
    """

    frames: Mapping[int, int]
    root: Array
    X: Array
    P: FactoredMobility | Array | Untouched
    prior: Mapping[int, Array]
    size: Mapping[int, Array]
    N: Array
    kept: Scalar = 0
    weakest: Scalar = 1.0

    def dense(self) -> Array | None:
        """Return the mobility as a matrix; None if it is in factors."""
        return (
            self.P.dense if isinstance(self.P, Untouched) else None if isinstance(self.P, FactoredMobility) else self.P
        )

    def in_factors(self) -> Belief:
        """Return the state with P in factors."""
        if isinstance(self.P, FactoredMobility):
            return self
        if isinstance(self.P, Untouched):
            return self._replace(P=self.P.factors)
        ((_, size),) = self.size.items()
        return self._replace(P=factored(self.P, sizes_of_rows(size)))

    @property
    def factors(self) -> FactoredMobility:
        """P in factors."""
        found = self.in_factors().P
        assert isinstance(found, FactoredMobility)
        return found

    @property
    def width(self) -> int:
        """Number c of columns."""
        return self.root.shape[1]

    def slice_of(self, frame: int) -> slice:
        """Return the rows of a frame."""
        return rows_of(self.frames, frame)

    def placed(self, ends: Sequence[tuple[int | None, Array]]) -> tuple[dict[int, Array], Array]:
        """Return rows by open frame, and those on the columns (rows, c)."""
        on: dict[int, Array] = {}
        on_root = np.zeros((len(ends[0][1]), self.width))
        for frame, rows in ends:
            if frame == ROOT:
                on_root = on_root + (rows if rows.shape[1] == self.width else rows @ self.root)
            elif frame is not None:
                on[frame] = on[frame] + rows if frame in on else rows
        return on, on_root

    def with_frame(self, frame: int, X: Array, w: Array, prior: Array) -> Belief:
        """Return the state with one more frame.

        Args:
            frame: its number.
            X: (size, c).
            w: (size, factors) its rows of the present factors.
            prior: (size, size) its mobility without measurements.
        """
        columns = [np.concatenate([own, more]) for own, more in zip(self.factors.w, w.T, strict=True)]
        return self._replace(
            frames={**self.frames, frame: len(X)},
            X=np.concatenate([self.X, X]),
            P=FactoredMobility(self.factors.D, columns),
            prior={**self.prior, frame: prior},
        )

    def with_rows(self, frame: int, X: Array, w: Array, prior: Array) -> Belief:
        """Return the state with other rows of an open frame; see `with_frame`."""
        at = self.slice_of(frame)
        before, after = slice(0, at.start), slice(at.stop, None)
        columns = [np.concatenate([o[before], m, o[after]]) for o, m in zip(self.factors.w, w.T, strict=True)]
        return self._replace(
            X=np.concatenate([self.X[before], X, self.X[after]]),
            P=FactoredMobility(self.factors.D, columns),
            prior={**self.prior, frame: prior},
        )

    def plus(self, D: Array, w: Mapping[int, Array]) -> Belief:
        """Return the state with P + sum D w w^T.

        Args:
            D: (m,) factors.
            w: by frame, its rows of their columns, (size, m).
        """
        blocks = [w[name] if name in w else np.zeros((size, len(D))) for name, size in self.frames.items()]
        P = self.factors
        return self._replace(P=P.plus(D.tolist(), [array(c) for c in np.concatenate(blocks).T]))

    def without(self, frame: int) -> Belief:
        """Return the state without a frame."""
        at = self.slice_of(frame)
        before, after = slice(0, at.start), slice(at.stop, None)
        frames = {name: size for name, size in self.frames.items() if name != frame}
        kept = FactoredMobility([], [])
        if frames:
            columns = [np.concatenate([one[before], one[after]]) for one in self.factors.w]
            kept = FactoredMobility(self.factors.D, columns).limited()
        return self._replace(
            frames=frames,
            X=np.concatenate([self.X[before], self.X[after]]),
            P=kept,
            prior={name: self.prior[name] for name in frames},
            size={name: size for name, size in self.size.items() if name in frames},
        )

    def factors_at(self, frame: int) -> Array:
        """Return the frame's rows of the factors, (size, factors)."""
        at, w = self.slice_of(frame), self.factors.w
        return array([one[at] for one in w]).reshape(len(w), self.frames[frame]).T

    def coefficients(self, on: Mapping[int, Array], count: int) -> Array:
        """Return coefficients by frame as a matrix (count, n)."""
        blocks = [on[name] if name in on else np.zeros((count, size)) for name, size in self.frames.items()]
        return np.concatenate([np.zeros((count, 0)), *blocks], axis=1)

    def sizes_of(self, on: Mapping[int, Array], count: int) -> Array:
        """Return the sizes of the variances of rows: squares of their blocks times traces of the blocks of P.

        No axis and no zero decides, so that a row that consists of rounding is small compared with its size. The size
        is that without measurements.
        """
        total = np.zeros(count)
        for name, C in on.items():
            of = np.diag(self.prior[name])
            for block in (slice(0, 3), slice(3, 6)) if len(of) == 6 else (slice(0, len(of)),):
                total = total + (C[:, block] * C[:, block]).sum(axis=1) * of[block].sum()
        return total


def sizes_of_rows(size: Array) -> Array:
    """Return the sizes of the rows of P, (6,), from (3,) sizes."""
    return np.repeat(size[:2], 3)


def rows_of(frames: Mapping[int, int], frame: int | None) -> slice:
    """Return the rows of one of the frames, whose numbers of rows are given in order."""
    start = 0
    for name, size in frames.items():
        if name == frame:
            return slice(start, start + size)
        start += size
    raise KeyError(frame)


def empty_belief(root: Array) -> Belief:
    """Return the state without open frames; `root` is the acceleration of the root per column."""
    count = root.shape[1]
    return Belief({}, root, np.zeros((0, count)), FactoredMobility([], []), {}, {}, np.zeros((count, count)))


def with_measurement(
    now: Belief, on: Mapping[int, Array], on_root: Array, K: Array, tolerance: float = RANK_TOLERANCE
) -> tuple[Belief, MeasuredRows]:
    """Return the state after including rows of a closure or a coupling.

    The row along which most is still free, relative to its size, comes first. A row with sigma <= tolerance size
    depends on earlier ones and changes nothing.

    Args:
        now: the state before.
        on: by frame, coefficients (rows, size).
        on_root: (rows, c) coefficients of beta.
        K: (rows, k) wrench, or multiplier, per unit of lambda.
        tolerance: relative size of a pivot that counts as zero.
    """
    now, count, n, width = now.in_factors(), len(K), len(now.X), on_root.shape[1]
    sizes = now.sizes_of(on, count)
    table = np.column_stack([now.coefficients(on, count), -on_root, K, sizes])
    found, wrenches, picks = [], [], []
    for _ in range(count):
        row, table, preferred = _most_free(now.factors, table, n)
        c, e, K, size = row[:n], row[n : n + width], row[n + width : -1], row[-1]
        P, own, sigma, alive = included_row(now.X, now.factors, c, 0.0, e, tolerance * size)
        some = where(size > 0.0, size, 1.0)
        now = now._replace(
            X=now.X + outer(own.k, own.nu),
            P=P,
            N=now.N + outer(own.e, own.nu),
            kept=now.kept + where(alive, 1, 0),
            weakest=minimum(now.weakest, where(alive, sigma / some, 1.0)),
        )
        found.append(own)
        wrenches.append(K)
        picks.append(preferred)

    def in_order(r: Array) -> Array:
        rest, ordered = r[:, None], []
        for preferred in picks:
            first, rest = picked(preferred, rest)
            ordered.append(first[0])
        return array(ordered)

    return now, MeasuredRows(RowSums(found, in_order), wrenches)


def _most_free(P: FactoredMobility, table: Array, n: int) -> tuple[Array, Array, list[Scalar]]:
    """Return the row of a table (rows, n + .. + size) with the largest sigma / size; see `first_by`."""
    sigma = np.zeros(len(table))
    for D, w in zip(P.D, P.w, strict=True):
        f = table[:, :n] @ w
        sigma = sigma + D * f * f
    return first_by(sigma, table)


def first_by(variance: Array, table: Array) -> tuple[Array, Array, list[Scalar]]:
    """Return the row of a table with the largest variance relative to its size, the last column, the others, and picks.

    The choices, 1 or 0, can be repeated for other columns (`picked`).
    """
    most, *rest = relative(variance, table[:, -1])
    picks = []
    for s in rest:
        picks.append(where(s > most, 1.0, 0.0))
        most = maximum(most, s)
    return *picked(picks, table), picks


def picked(picks: list[Scalar], table: Array) -> tuple[Array, Array]:
    """Return the preferred row of a table and the others, where every row after the first may be preferred."""
    row, others = table[0], []
    for one, more in zip(table[1:], picks, strict=True):
        others.append(select(more > 0.5, row, one))
        row = select(more > 0.5, one, row)
    return row, array(others).reshape(-1, table.shape[1])


def relative(variance: Array, size: Array) -> list[Scalar]:
    """Return variances relative to their sizes; what has no size has no variance."""
    return [where(s > 0.0, v / where(s > 0.0, s, 1.0), 0.0) for v, s in zip(variance, size, strict=True)]
