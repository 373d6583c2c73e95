"""Maximisation of the least of several margins, a second-order cone program.

    maximise t  subject to  c_j + a_j.z - t >= |b_j + B_j z|  for every j,  |z| <= reach,
                            and c >= |b + B z|  for every limit

It is solved by Newton's method along the central path of its logarithmic barrier (Y. Nesterov, A. Nemirovskii,
Interior-Point Polynomial Algorithms in Convex Programming, 1994). With m cones, the solution t at weight w is within
2 m w of the maximum.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.constraint import NULL_SINGULAR_VALUE
from holdfast.spatial.scalar import Array

STEEPEST = 1e-6  # N of margin per N of squeezing: a smaller slope is rounding
LARGEST_UNKNOWN = 1e6  # largest |z|, relative to the size of the forces, for a supremum that is not attained
MARGIN_PRECISION = 1e-10  # relative to the size of the forces
INSIDE = 1e-6  # a search begins only where the limits are satisfied by more than this relative amount
CENTRED_DECREMENT = 1e-3  # Newton decrement below which a point is close enough to the central path
MOST_BARRIER_STEPS = 200


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
    of the largest constant. The cost is about a hundred Newton steps of O(k^3).

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
    still = np.zeros(basis.shape[1])
    start = still
    size = max(max(abs(m.c), float(np.abs(m.b).max())) for m in margins) or 1.0
    # z is in units of `size`, and each limit is divided by its constant
    kept = [AffineMargin(1.0, m.a, m.b / m.c, m.B * size / m.c) for m in limits]
    if kept and min(m.at(still) for m in kept) < INSIDE:
        start = _maximum(kept, [], LARGEST_UNKNOWN, still) if len(still) else still
        if min(m.at(start) for m in kept) <= 0.0:
            return Largest(-math.inf, np.zeros(k))
    if not len(still):
        return Largest(min(m.at(still) for m in margins), np.zeros(k))
    slopes = [m.slope().along(_unlimited(kept, len(still))) for m in margins]
    nowhere = np.zeros(len(slopes[0].a))
    if len(nowhere) and min(m.at(_maximum(slopes, [], 1.0, nowhere)) for m in slopes) > STEEPEST:
        return Largest(math.inf, np.zeros(k))
    scaled = [m.scaled(size) for m in margins]
    z = _maximum(scaled, kept, LARGEST_UNKNOWN, start)
    return Largest(float(size) * min(m.at(z) for m in scaled), basis @ (float(size) * z))


def _unlimited(limits: list[AffineMargin], k: int) -> Array:
    """Return an orthonormal basis of the directions of z that the limits do not bound, (k, directions)."""
    if not limits:
        return np.eye(k)
    _, sizes, directions = np.linalg.svd(np.vstack([m.B for m in limits]))
    rank = int((sizes > NULL_SINGULAR_VALUE * max(1.0, sizes.max(initial=0.0))).sum())
    return directions[rank:].T


def _maximum(margins: list[AffineMargin], limits: list[AffineMargin], reach: float, start: Array) -> Array:
    """Return the z, |z| <= reach, for which the least margin is largest; margins and z are scaled to size one.

    Args:
        margins: at least one.
        limits: constraints.
        reach: largest |z|.
        start: a z that satisfies all limits strictly.
    """
    k = len(start)
    cones = [AffineMargin(m.c, np.r_[m.a, -1.0], m.b, np.c_[m.B, np.zeros(len(m.b))]) for m in margins]
    cones += [AffineMargin(m.c, np.r_[m.a, 0.0], m.b, np.c_[m.B, np.zeros(len(m.b))]) for m in limits]
    cones.append(AffineMargin(reach, np.zeros(k + 1), np.zeros(k), np.eye(k, k + 1)))
    x = np.r_[start, min(m.at(start) for m in margins) - 1.0]  # (z, t), inside every cone
    weight = 1.0
    while True:
        x = _centred(cones, x, weight)
        if 2 * len(cones) * weight < MARGIN_PRECISION:
            return x[:k]
        weight *= 0.1


def _centred(cones: list[AffineMargin], x: Array, weight: float) -> Array:
    """Return the minimiser of -t / weight - sum log(u^2 - v.v) with u = c + a.x and v = b + B x, from an interior x.

    The function is self-concordant, so Newton steps scaled by 1 / (1 + decrement) stay in the interior.
    """
    for _ in range(MOST_BARRIER_STEPS):
        gradient, curvature = np.zeros_like(x), np.zeros((len(x), len(x)))
        gradient[-1] = -1.0 / weight
        for cone in cones:
            u, v = cone.c + cone.a @ x, cone.b + cone.B @ x
            length = np.sqrt(v @ v)
            depth = (u - length) * (u + length)
            rise = 2.0 * (u * cone.a - v @ cone.B) / depth
            gradient -= rise
            curvature += np.outer(rise, rise) - 2.0 * (np.outer(cone.a, cone.a) - cone.B.T @ cone.B) / depth
        step = -np.linalg.lstsq(curvature, gradient, rcond=None)[0]
        decrement = float(np.sqrt(max(-gradient @ step, 0.0)))
        step /= 1.0 + decrement if decrement > 0.25 else 1.0
        if decrement < CENTRED_DECREMENT or min(cone.at(x + step) for cone in cones) <= 0.0:
            break  # rounding prevents further progress
        x = x + step
    return x
