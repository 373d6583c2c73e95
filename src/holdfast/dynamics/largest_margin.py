"""The largest value that the least of several margins can be given: a second-order cone program.

    maximise t  subject to  c_j + a_j.z - t >= |b_j + B_j z|  for every j,  |z| <= reach

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


def largest_least(margins: list[AffineMargin]) -> float:
    """Return the supremum over z of the least of the margins; infinite if it grows for ever.

    It grows for ever exactly if some direction has a positive slope in every margin. Good to about
    1e-9 of the largest constant. Some hundred Newton steps of O(k^3).

    Args:
        margins: at least one.
    """
    basis = felt_directions(margins)
    margins = [m.along(basis) for m in margins]
    still = np.zeros(basis.shape[1])
    if not basis.shape[1]:
        return min(m.at(still) for m in margins)
    if _maximum([m.slope() for m in margins], 1.0) > STEEPEST:
        return math.inf
    size = max(max(abs(m.c), float(np.abs(m.b).max())) for m in margins) or 1.0
    return float(size) * _maximum([m.scaled(size) for m in margins], FARTHEST)


def _maximum(margins: list[AffineMargin], reach: float) -> float:
    """Return the largest least margin with |z| <= reach, for margins and z of size one."""
    k = len(margins[0].a)
    cones = [AffineMargin(m.c, np.r_[m.a, -1.0], m.b, np.c_[m.B, np.zeros(len(m.b))]) for m in margins]
    cones.append(AffineMargin(reach, np.zeros(k + 1), np.zeros(k), np.eye(k, k + 1)))
    x = np.zeros(k + 1)
    x[k] = min(m.at(x[:k]) for m in margins) - 1.0  # (z, t), inside every cone
    weight = 1.0
    while True:
        x = _centred(cones, x, weight)
        if 2 * len(cones) * weight < PRECISION:
            return min(m.at(x[:k]) for m in margins)
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
