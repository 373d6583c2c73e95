"""Maximisation of the least of several margins, a second-order cone program.

    maximise t  subject to  c_j + a_j.z - t >= |b_j + B_j z|  for every j,  |z| <= reach,
                            and c >= |b + B z|  for every limit

It is solved by `cone_solver`. Where the supremum is not attained, |z| is bounded by a multiple of the forces.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.constraint import NULL_SINGULAR_VALUE
from holdfast.forces.cone_solver import ConeProgramme, Cones, Verdict, solve
from holdfast.spatial.scalar import Array

STEEPEST = 1e-6  # N of margin per N of squeezing: a smaller slope is rounding
LARGEST_UNKNOWN = 1e6  # largest |z|, relative to the size of the forces, for a supremum that is not attained


class AffineMargin(NamedTuple):
    """A margin c + a.z - |b + B z| as a function of unknown internal forces z, (k,).

    Attributes:
        c: constant.
        a: (k,) coefficients of z.
        b: (rows,) load at z = 0.
        B: (rows, k) load per z.
    """

    c: float
    a: Array
    b: Array
    B: Array

    def at(self, z: Array) -> float:
        """Return the margin at z."""
        load = self.b + self.B @ z
        return float(self.c + self.a @ z - np.sqrt(load @ load))

    def along(self, basis: Array) -> AffineMargin:
        """Return the margin as a function of y with z = basis y."""
        return self._replace(a=self.a @ basis, B=self.B @ basis)

    def slope(self) -> AffineMargin:
        """Return the homogeneous part of the margin, which gives its growth for large z."""
        return self._replace(c=0.0, b=0.0 * self.b)

    def scaled(self, size: float) -> AffineMargin:
        """Return the margin divided by a size, as a function of z divided by the same size."""
        return self._replace(c=self.c / size, b=self.b / size)


def sensitive_directions(margins: list[AffineMargin]) -> Array:
    """Return an orthonormal basis of the directions of z that change any of the margins, (k, directions)."""
    rows = np.vstack([np.vstack([m.a, m.B]) for m in margins])
    _, sizes, directions = np.linalg.svd(rows, full_matrices=False)
    return directions[sizes > NULL_SINGULAR_VALUE * max(1.0, sizes.max(initial=0.0))].T


class Largest(NamedTuple):
    """The largest value of the least margin, and the point at which it is attained.

    Attributes:
        value: the supremum; minus infinity if no z satisfies the limits, infinite if it is unbounded.
        z: (k,) the maximiser; zero if the value is infinite.
    """

    value: float
    z: Array


def largest_least(margins: list[AffineMargin]) -> float:
    """Return the supremum over z of the least of the margins; infinite if it is unbounded.

    It is unbounded exactly if all margins have a positive slope in some direction. The result is accurate to about 1e-9
    of the largest constant. Some 12 steps of O(k^3).

    Args:
        margins: at least one.
    """
    return largest_within(margins, []).value


def largest_within(margins: list[AffineMargin], limits: list[AffineMargin]) -> Largest:
    """Return the supremum of the least of the margins over all z for which all limits are >= 0.

    Args:
        margins: at least one.
        limits: constraints, constant > |load| (a = 0); each may have its own unit, because it is scaled by its
            constant.
    """
    k = len(margins[0].a)
    basis = sensitive_directions([*margins, *limits])
    margins, limits = ([m.along(basis) for m in some] for some in (margins, limits))
    size = max(max(abs(m.c), float(np.abs(m.b).max())) for m in margins) or 1.0
    # z is in units of `size`, and each limit is divided by its constant
    kept = [AffineMargin(1.0, m.a, m.b / m.c, m.B * size / m.c) for m in limits]
    slopes = [m.slope().along(_unlimited(kept, basis.shape[1])) for m in margins]
    steepest = _maximum(slopes, [], 1.0) if len(slopes[0].a) else np.zeros(0)
    scaled = [m.scaled(size) for m in margins]
    z = _maximum(scaled, kept, LARGEST_UNKNOWN)
    if z is None:
        return Largest(-math.inf, np.zeros(k))
    if steepest is not None and len(steepest) and min(m.at(steepest) for m in slopes) > STEEPEST:
        return Largest(math.inf, np.zeros(k))
    return Largest(float(size) * min(m.at(z) for m in scaled), basis @ (float(size) * z))


def _unlimited(limits: list[AffineMargin], k: int) -> Array:
    """Return an orthonormal basis of the directions of z that the limits do not bound, (k, directions)."""
    if not limits:
        return np.eye(k)
    _, sizes, directions = np.linalg.svd(np.vstack([m.B for m in limits]))
    rank = int((sizes > NULL_SINGULAR_VALUE * max(1.0, sizes.max(initial=0.0))).sum())
    return directions[rank:].T


def _maximum(margins: list[AffineMargin], limits: list[AffineMargin], reach: float) -> Array | None:
    """Return the z, |z_j| <= reach, for which the least margin is largest; None if no z satisfies the limits.

    Args:
        margins: at least one, scaled to size one.
        limits: constraints, scaled likewise.
        reach: largest entry of z.
    """
    k, every = len(margins[0].a), [*margins, *limits]
    size = 1 + max(len(m.b) for m in every)
    cones = Cones(2 * k, len(every), size)
    G, h = np.zeros((2 * k + size * len(every), k + 1)), np.ones(2 * k + size * len(every))
    G[:k, :k], G[k : 2 * k, :k] = np.eye(k) / reach, -np.eye(k) / reach
    h[2 * k :] = 0.0
    for i, m in enumerate(every):
        first = 2 * k + size * i
        rows = slice(first + 1, first + 1 + len(m.b))
        G[first, :k], G[rows, :k], h[first], h[rows] = -m.a, -m.B, m.c, m.b
        G[first, k] = 1.0 if i < len(margins) else 0.0
    found = solve(ConeProgramme(np.zeros((k + 1, k + 1)), -np.eye(k + 1)[k], G, h, cones))
    return None if found.verdict is Verdict.INFEASIBLE else found.x[:k]
