"""The state of the elimination of a part: accelerations of open frames, and the mobility with which they are known.

The acceleration of the open frames for given forces is x + X beta + P s, where beta is the acceleration of the part's
root, and s are the wrenches of what has not been included yet. P = sum D w w^T remains in factors; nothing is
subtracted from it (`FactoredMobility`). What the measured rows say about beta is a sum of squares at the root:

    row c z + c_root beta = r, noise d:    e = [r - c x | -c_root - c X],  sigma = d + c P c^T,  k = P c^T
    [x | X] += k e / sigma,    [n | N] += e_beta^T e / sigma,    D, w by Bierman's update
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.factored_mobility import FactoredMobility, updated
from holdfast.spatial.linalg import RANK_TOLERANCE
from holdfast.spatial.scalar import Array, Scalar, array, minimum, select, where
from holdfast.spatial.vector import outer


class Rows(NamedTuple):
    """Rows of a closure or a coupling.

    Attributes:
        on: by frame, their coefficients (rows, size).
        e: (rows, 1 + c) [r | -c_root].
        K: (rows, k) wrench, or multiplier, per unit of lambda.
        noise: (rows,) d, the mobility of what no frame is open for; zeros without such a chain.
        own_size: (rows,) size of the terms of d.
    """

    on: Mapping[int, Array]
    e: Array
    K: Array
    noise: Array
    own_size: Array


class MeasuredRow(NamedTuple):
    """A row that has been included, for the way back: lambda = nu [1 | beta] - gain s, s += c^T lambda.

    Attributes:
        c: (n,) its coefficients.
        gain: (n,) k / sigma; 0 for a dependent row, like nu.
        nu: (1 + c,) e / sigma.
        k: (k,) wrench, or multiplier, per unit of lambda.
    """

    c: Array
    gain: Array
    nu: Array
    k: Array


class Belief(NamedTuple):
    """Open frames at one moment.

    Attributes:
        frames: number of rows by open frame, the oldest first.
        x: (n, 1 + c) [x | X].
        P: mobility in factors (n,).
        prior: by frame, its mobility without any measurement, (size, size), from which sizes of pivots follow.
        on_root: (c, 1 + c) [n | N], load and inertia at the root.
        kept: number of independent rows.
        weakest: the smallest pivot of these rows, relative to its size.
    """

    frames: Mapping[int, int]
    x: Array
    P: FactoredMobility
    prior: Mapping[int, Array]
    on_root: Array
    kept: Scalar = 0
    weakest: Scalar = 1.0

    def slice_of(self, frame: int) -> slice:
        """Return the rows of a frame."""
        start = 0
        for name, size in self.frames.items():
            if name == frame:
                return slice(start, start + size)
            start += size
        raise KeyError(frame)

    def with_frame(self, frame: int, x: Array, w: Array, prior: Array) -> Belief:
        """Return the state with one more frame.

        Args:
            frame: its number.
            x: (size, 1 + c) its mean.
            w: (size, factors) its rows of the present factors.
            prior: (size, size) its mobility without measurements.
        """
        columns = [np.concatenate([own, more]) for own, more in zip(self.P.w, w.T, strict=True)]
        return self._replace(
            frames={**self.frames, frame: len(x)},
            x=np.concatenate([self.x, x]),
            P=FactoredMobility(self.P.D, columns),
            prior={**self.prior, frame: prior},
        )

    def with_rows(self, frame: int, x: Array, w: Array, prior: Array) -> Belief:
        """Return the state with other rows of an open frame; see `with_frame`."""
        at = self.slice_of(frame)
        before, after = slice(0, at.start), slice(at.stop, None)
        columns = [np.concatenate([o[before], m, o[after]]) for o, m in zip(self.P.w, w.T, strict=True)]
        return self._replace(
            x=np.concatenate([self.x[before], x, self.x[after]]),
            P=FactoredMobility(self.P.D, columns),
            prior={**self.prior, frame: prior},
        )

    def plus(self, D: Array, w: Mapping[int, Array]) -> Belief:
        """Return the state with P + sum D w w^T.

        Args:
            D: (m,) factors.
            w: by frame, its rows of their columns, (size, m).
        """
        blocks = [w[name] if name in w else np.zeros((size, len(D))) for name, size in self.frames.items()]
        more = FactoredMobility([*self.P.D, *D.tolist()], [*self.P.w, *(array(c) for c in np.concatenate(blocks).T)])
        return self._replace(P=_compact(more))

    def without(self, frame: int) -> Belief:
        """Return the state without a frame."""
        at = self.slice_of(frame)
        before, after = slice(0, at.start), slice(at.stop, None)
        frames = {name: size for name, size in self.frames.items() if name != frame}
        columns = [np.concatenate([one[before], one[after]]) for one in self.P.w]
        return self._replace(
            frames=frames,
            x=np.concatenate([self.x[before], self.x[after]]),
            P=_compact(FactoredMobility(self.P.D, columns)) if frames else FactoredMobility([], []),
            prior={name: self.prior[name] for name in frames},
        )

    def factors_at(self, frame: int) -> Array:
        """Return the frame's rows of the factors, (size, factors)."""
        at = self.slice_of(frame)
        return array([one[at] for one in self.P.w]).reshape(len(self.P.w), self.frames[frame]).T

    def mobility_of(self, frame: int) -> Array:
        """Return the frame's rows of P, (size, n)."""
        W = array(self.P.w).reshape(len(self.P.w), len(self.x))
        return (self.factors_at(frame) * array(self.P.D)) @ W

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


def empty_belief(columns: int) -> Belief:
    """Return the state without open frames; `columns` is the number of components of the root's acceleration."""
    none = np.zeros((columns, 1 + columns))
    return Belief({}, np.zeros((0, 1 + columns)), FactoredMobility([], []), {}, none)


def _compact(P: FactoredMobility) -> FactoredMobility:
    """Return a mobility with as many factors as rows if there are more than twice as many and six."""
    return P.compressed() if P.w and len(P.D) > 2 * len(P.w[0]) + 6 else P


def with_measurement(now: Belief, rows: Rows, tolerance: float = RANK_TOLERANCE) -> tuple[Belief, list[MeasuredRow]]:
    """Return the state after including rows, and what the way back needs of them.

    The row along which most is still free, relative to its size, comes first. A row with sigma <= tolerance size
    depends on earlier ones and changes nothing.
    """
    count, n, width = len(rows.e), len(now.x), rows.e.shape[1]
    sizes = now.sizes_of(rows.on, count) + rows.own_size
    table = np.column_stack([now.coefficients(rows.on, count), rows.e, rows.K, rows.noise, sizes])
    found = []
    for _ in range(count):
        row, table = _most_free(now.P, table, n)
        c, e, K, d, size = row[:n], row[n : n + width], row[n + width : -2], row[-2], row[-1]
        P, k, sigma, alive = updated(now.P, c, d, tolerance * size)
        inverse = where(alive, 1.0 / where(alive, sigma, 1.0), 0.0)
        e = e - c @ now.x
        nu, gain = inverse * e, inverse * k
        some = where(size > 0.0, size, 1.0)
        now = now._replace(
            x=now.x + outer(k, nu),
            P=P,
            on_root=now.on_root + outer(e[1:], nu),
            kept=now.kept + where(alive, 1, 0),
            weakest=minimum(now.weakest, where(alive, sigma / some, 1.0)),
        )
        found.append(MeasuredRow(c, gain, nu, K))
    return now, found


def _most_free(P: FactoredMobility, table: Array, n: int) -> tuple[Array, Array]:
    """Return the row of a table (rows, n + .. + d + size) with the largest sigma / size, and the other rows."""
    F = [table[:, :n] @ w for w in P.w]
    sigma = table[:, -2]
    for D, f in zip(P.D, F, strict=True):
        sigma = sigma + D * f * f
    return first_by(sigma, table)


def first_by(variance: Array, table: Array) -> tuple[Array, Array]:
    """Return the row of a table with the largest variance relative to its size, the last column, and the others."""
    row, (most, *rest), others = table[0], relative(variance, table[:, -1]), []
    for one, s in zip(table[1:], rest, strict=True):
        more = s > most
        others.append(select(more, row, one))
        row, most = select(more, one, row), where(more, s, most)
    return row, array(others).reshape(-1, table.shape[1])


def relative(variance: Array, size: Array) -> list[Scalar]:
    """Return variances relative to their sizes; what has no size has no variance."""
    return [where(s > 0.0, v / where(s > 0.0, s, 1.0), 0.0) for v, s in zip(variance, size, strict=True)]
