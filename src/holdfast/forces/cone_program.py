"""The largest value that the least of several margins can be given: a second-order cone program.

    maximise t  subject to  c_j + a_j.z - t >= |b_j + B_j z|  for every j,  |z| <= reach,
                            and c >= |b + B z|  for every limit

solved along the central path of its logarithmic barrier by Newton's method (Y. Nesterov, A. Nemirovskii,
Interior-Point Polynomial Algorithms in Convex Programming, 1994): with m cones the t found at weight w is
within 2 m w of the largest.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from holdfast.spatial.scalar import Array

STEEPEST = 1e-6  # N of margin per N of squeezing: less is rounding
FARTHEST = 1e6  # of the sizes given: how far z is followed towards a value that is approached but not reached
PRECISION = 1e-10  # of the sizes given
INSIDE = 1e-6  # of a limit: nearer to it than this a search does not begin
CENTRED = 1e-3  # Newton decrement that is near enough to the central path
MOST_STEPS = 200
NULL_SINGULAR_VALUE = 1e-9


class AffineMargin(NamedTuple):
    """A margin c + a.z - |b + B z| of unknown internal forces z, (k,).

    Attributes:
        c: margin without load at z = 0.
        a: (k,).
        b: (rows,).
        B: (rows, k).
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
        """Return the margin of y where z = basis y."""
        return self._replace(a=self.a @ basis, B=self.B @ basis)

    def slope(self) -> AffineMargin:
        """Return how the margin grows far away along z: its homogeneous part."""
        return self._replace(c=0.0, b=0.0 * self.b)

    def scaled(self, size: float) -> AffineMargin:
        """Return the margin over a size, of z over the same size."""
        return self._replace(c=self.c / size, b=self.b / size)


def felt_directions(margins: list[AffineMargin]) -> Array:
    """Return an orthonormal basis of the directions of z that any of the margins feels, (k, directions)."""
    rows = np.vstack([np.vstack([m.a, m.B]) for m in margins])
    _, sizes, directions = np.linalg.svd(rows, full_matrices=False)
    return directions[sizes > NULL_SINGULAR_VALUE * max(1.0, sizes.max(initial=0.0))].T


class Largest(NamedTuple):
    """The largest value of the least margin, and where it is.

    Attributes:
        value: minus infinity if no z keeps the limits, infinite if it grows for ever.
        z: (k,) where it is taken; where it is infinite or there is none, zero.
    """

    value: float
    z: Array


def largest_least(margins: list[AffineMargin]) -> float:
    """Return the supremum over z of the least of the margins; infinite if it grows for ever.

    It grows for ever exactly if some direction has a positive slope in every margin. Good to about
    1e-9 of the largest constant. Some hundred Newton steps of O(k^3).

    Args:
        margins: at least one.
    """
    return largest_within(margins, []).value


def largest_within(margins: list[AffineMargin], limits: list[AffineMargin]) -> Largest:
    """Return the supremum over z of the least of the margins where all limits are >= 0.

    Args:
        margins: at least one.
        limits: what is only to be kept, constants > |loads| (a = 0); of any units, as each is scaled by its constant.
    """
    k = len(margins[0].a)
    basis = felt_directions([*margins, *limits])
    margins, limits = ([m.along(basis) for m in some] for some in (margins, limits))
    still = np.zeros(basis.shape[1])
    start = still
    size = max(max(abs(m.c), float(np.abs(m.b).max())) for m in margins) or 1.0
    # z counts in units of `size`; a limit is of size one by its own constant
    kept = [AffineMargin(1.0, m.a, m.b / m.c, m.B * size / m.c) for m in limits]
    if kept and min(m.at(still) for m in kept) < INSIDE:
        start = _maximum(kept, [], FARTHEST, still) if len(still) else still
        if min(m.at(start) for m in kept) <= 0.0:
            return Largest(-math.inf, np.zeros(k))
    if not len(still):
        return Largest(min(m.at(still) for m in margins), np.zeros(k))
    slopes = [m.slope().along(_unlimited(kept, len(still))) for m in margins]
    nowhere = np.zeros(len(slopes[0].a))
    if len(nowhere) and min(m.at(_maximum(slopes, [], 1.0, nowhere)) for m in slopes) > STEEPEST:
        return Largest(math.inf, np.zeros(k))
    scaled = [m.scaled(size) for m in margins]
    z = _maximum(scaled, kept, FARTHEST, start)
    return Largest(float(size) * min(m.at(z) for m in scaled), basis @ (float(size) * z))


def _unlimited(limits: list[AffineMargin], k: int) -> Array:
    """Return an orthonormal basis of the directions of z that no limit ends, |loads| <= constants, (k, directions)."""
    if not limits:
        return np.eye(k)
    _, sizes, directions = np.linalg.svd(np.vstack([m.B for m in limits]))
    rank = int((sizes > NULL_SINGULAR_VALUE * max(1.0, sizes.max(initial=0.0))).sum())
    return directions[rank:].T


def _maximum(margins: list[AffineMargin], limits: list[AffineMargin], reach: float, start: Array) -> Array:
    """Return where the least margin is largest, |z| <= reach, for margins and z of size one.

    Args:
        margins: at least one.
        limits: to be kept.
        reach: how far z may go.
        start: z inside all limits.
    """
    k = len(start)
    cones = [AffineMargin(m.c, np.r_[m.a, -1.0], m.b, np.c_[m.B, np.zeros(len(m.b))]) for m in margins]
    cones += [AffineMargin(m.c, np.r_[m.a, 0.0], m.b, np.c_[m.B, np.zeros(len(m.b))]) for m in limits]
    cones.append(AffineMargin(reach, np.zeros(k + 1), np.zeros(k), np.eye(k, k + 1)))
    x = np.r_[start, min(m.at(start) for m in margins) - 1.0]  # (z, t), inside every cone
    weight = 1.0
    while True:
        x = _centred(cones, x, weight)
        if 2 * len(cones) * weight < PRECISION:
            return x[:k]
        weight *= 0.1


def _centred(cones: list[AffineMargin], x: Array, weight: float) -> Array:
    """Return the minimiser of -t / weight - sum log(u^2 - v.v), u = c + a.x and v = b + B x, from x inside.

    The function is self-concordant: Newton steps shortened to 1 / (1 + decrement) stay inside.
    """
    for _ in range(MOST_STEPS):
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
        if decrement < CENTRED or min(cone.at(x + step) for cone in cones) <= 0.0:
            break  # as near as rounding allows
        x = x + step
    return x
