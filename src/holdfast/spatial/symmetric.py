"""Symmetric 6x6 matrices (inertias, mobilities) as three 3x3 blocks.

    X = [ aa    al ]      aa, ll symmetric;  a = angular, l = linear
        [ al^T  ll ]

An inertia maps twists to wrenches, X' = phi X phi^T when its point moves; a mobility
maps wrenches to twists, X' = phi^T X phi. Both are cross products, never 6x6 products.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.spatial.scalar import Array, array, concatenate
from holdfast.spatial.vector import outer, skew


class Symmetric6(NamedTuple):
    """A symmetric 6x6 matrix; see the module's text for the blocks."""

    aa: Array
    al: Array
    ll: Array

    def plus(self, other: Symmetric6) -> Symmetric6:
        """Return the sum of two symmetric matrices."""
        return Symmetric6(self.aa + other.aa, self.al + other.al, self.ll + other.ll)

    def apply(self, x: Array) -> Array:
        """Return X x for a 6-vector."""
        a, l = x[:3], x[3:]
        return concatenate([self.aa @ a + self.al @ l, a @ self.al + self.ll @ l])

    def plus_outer(self, u: Array, s: Array) -> Symmetric6:
        """Return X + u s^T, where the caller knows u s^T to be symmetric."""
        return Symmetric6(
            mirrored(self.aa + outer(u[:3], s[:3])),
            self.al + outer(u[:3], s[3:]),
            mirrored(self.ll + outer(u[3:], s[3:])),
        )

    def plus_symmetric_outer(self, u: Array, s: Array) -> Symmetric6:
        """Return X + u s^T + s u^T."""
        a, l, b, m = u[:3], u[3:], s[:3], s[3:]
        return Symmetric6(
            mirrored(self.aa + outer(a, b) + outer(b, a)),
            self.al + outer(a, m) + outer(b, l),
            mirrored(self.ll + outer(l, m) + outer(m, l)),
        )

    def rotated(self, R: Array) -> Symmetric6:
        """Return X in new axes: every block B becomes R B R^T."""
        return Symmetric6(mirrored(R @ self.aa @ R.T), R @ self.al @ R.T, mirrored(R @ self.ll @ R.T))

    def inertia_shifted(self, l: Array) -> Symmetric6:
        """Return phi X phi^T: an inertia at point b seen at a, l from a to b [m]."""
        lx = skew(l)
        al = self.al + lx @ self.ll
        return Symmetric6(mirrored(self.aa + lx @ self.al.T - al @ lx), al, self.ll)

    def mobility_shifted(self, l: Array) -> Symmetric6:
        """Return phi^T X phi: a mobility at point a seen at b, l from a to b [m]."""
        lx = skew(l)
        al = self.al + self.aa @ lx
        return Symmetric6(self.aa, al, mirrored(self.ll + self.al.T @ lx - lx @ al))

    def dense(self) -> Array:
        """Return the (6, 6) matrix."""
        return np.block([[self.aa, self.al], [self.al.T, self.ll]])


def symmetric6(X: Array) -> Symmetric6:
    """Return the blocks of a symmetric (6, 6) matrix, its upper triangle being read."""
    return Symmetric6(mirrored(X[:3, :3]), X[:3, 3:], mirrored(X[3:, 3:]))


def zero6() -> Symmetric6:
    """Return the zero matrix."""
    return Symmetric6(np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)))


def mirrored(B: Array) -> Array:
    """Return the square matrix with its upper triangle copied to the lower.

    Keeps symmetric what is symmetric in exact arithmetic, and lets a tracer drop
    the lower half's operations.
    """
    rows = B.tolist()
    n = range(len(rows))
    return array([[rows[min(i, j)][max(i, j)] for j in n] for i in n])


def symmetric_part(x: Array) -> Array:
    """Return the symmetric part of x, which is the gradient with respect to a symmetric matrix."""
    return 0.5 * (x + np.swapaxes(x, -1, -2))
