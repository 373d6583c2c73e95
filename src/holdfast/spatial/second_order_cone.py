"""The cone s_0 >= |s_1| and its scaling, for interior-point methods; s_1 has any length, also none.

Reference: Vandenberghe, "The CVXOPT linear and quadratic cone program solvers", 2010, sections 4 and 5.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.spatial.scalar import Array, Scalar, concatenate, maximum, reciprocal, sqrt
from holdfast.spatial.vector import outer

_LEAST = 1e-100  # of a determinant, which is positive inside of the cone; products of its inverse remain finite


class ConeScaling(NamedTuple):
    """The symmetric matrix W of Nesterov and Todd, with W z = W^-1 s.

    Attributes:
        w: its direction, w_0^2 - |w_1|^2 = 1.
        eta: its size.
        inverse: 1 / eta.
        scaled: W z = W^-1 s.
        of_s, of_z: 1 / sqrt(det) of s and z.
    """

    w: Array
    eta: Scalar
    inverse: Scalar
    scaled: Array
    of_s: Scalar
    of_z: Scalar

    def times(self, x: Array) -> Array:
        """Return W x."""
        return _turned(self.w, self.eta, x, 1.0)

    def over(self, x: Array) -> Array:
        """Return W^-1 x."""
        return _turned(self.w, self.inverse, x, -1.0)

    @property
    def square(self) -> Array:
        """W^2 = eta^2 (2 w w' - J), J = diag(1, -1, ..)."""
        signs = np.diag([1.0, *[-1.0] * (len(self.w) - 1)])
        return (self.eta * self.eta) * (outer(2.0 * self.w, self.w) - signs)

    @property
    def inverse_square(self) -> Array:
        """W^-2 = (2 (J w)(J w)' - J) / eta^2, J = diag(1, -1, ..)."""
        turned = concatenate([self.w[:1], -self.w[1:]])
        signs = np.diag([1.0, *[-1.0] * (len(self.w) - 1)])
        return (self.inverse * self.inverse) * (outer(2.0 * turned, turned) - signs)

    def corrected(self, ds: Array, dz: Array, centre: Scalar) -> Array:
        """Return W^-1 y with (W z) o y = W^-1 ds o W dz - centre [1, 0, ..], o the cone's product."""
        a, b, at = self.over(ds), self.times(dz), self.scaled
        first, rest = a @ b - centre, a[0] * b[1:] + b[0] * a[1:]
        x = (at[0] * first - at[1:] @ rest) * reciprocal(determinant(at))
        return self.over(concatenate([[x], (rest - x * at[1:]) * reciprocal(at[0])]))


def cone_scaling(s: Array, z: Array) -> ConeScaling:
    """Return the scaling at a slack and a multiplier inside of the cone."""
    of_s, of_z = reciprocal(sqrt(determinant(s))), reciprocal(sqrt(determinant(z)))
    a, b = s * of_s, z * of_z
    half = reciprocal(sqrt(2.0 + 2.0 * (a @ b)))
    w = concatenate([[(a[0] + b[0]) * half], (a[1:] - b[1:]) * half])
    inverse = sqrt(of_s * reciprocal(of_z))
    eta = reciprocal(inverse)
    return ConeScaling(w, eta, inverse, _turned(w, eta, z, 1.0), of_s, of_z)


def determinant(x: Array) -> Scalar:
    """Return x_0^2 - |x_1|^2, at least a tiny positive number."""
    size = sqrt(x[1:] @ x[1:])
    return maximum((x[0] - size) * (x[0] + size), _LEAST)


def cone_inverse(x: Array) -> Array:
    """Return x^-1, whose product with x in the cone's algebra is [1, 0, ..]."""
    return reciprocal(determinant(x)) * concatenate([x[:1], -x[1:]])


def step_rate(x: Array, of_x: Scalar, step: Array) -> Scalar:
    """Return the inverse of the largest multiple of a step that stays in the cone, negative if there is none.

    Args:
        x: a point inside of the cone.
        of_x: 1 / sqrt(det x).
        step: the step.
    """
    a = x * of_x
    along = a[0] * step[0] - a[1:] @ step[1:]
    across = step[1:] - ((along + step[0]) * reciprocal(1.0 + a[0])) * a[1:]
    return (sqrt(across @ across) - along) * of_x


def _turned(w: Array, size: Scalar, x: Array, sign: float) -> Array:
    along = sign * (w[1:] @ x[1:])
    rest = x[1:] + ((sign * x[0]) + along * sign * reciprocal(1.0 + w[0])) * w[1:]
    return size * concatenate([[w[0] * x[0] + along], rest])
