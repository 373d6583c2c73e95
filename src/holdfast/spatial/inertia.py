"""The inertia of a rigid body about a point, by its ten parameters."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.spatial.scalar import Array, Scalar, array, concatenate
from holdfast.spatial.symmetric import Symmetric6, mirrored
from holdfast.spatial.vector import cross, dot, outer, product, skew


class RigidInertia(NamedTuple):
    """M = [I, h~; -h~, m 1] about a point O, all in one set of axes (docs/theory/arm.md).

    Attributes:
        m: mass [kg].
        h: (3,) first moment, m times the vector from O to the mass centre [kg m].
        I: (3, 3) rotational inertia about O [kg m^2].
    """

    m: Scalar
    h: Array
    I: Array

    def apply(self, a: Array) -> Array:
        """Return M a for a 6-vector a."""
        return concatenate([self.I @ a[:3] + cross(self.h, a[3:]), self.m * a[3:] - cross(self.h, a[:3])])

    def wrench(self, a: Array, w: Array, K: Array) -> Array:
        """Return M a + b, what accelerates the body by a while it turns at w [rad/s].

        [I alpha + w x I w + h x a; m a + K h], with K = alpha~ + w~ w~ of the body
        (`acceleration_gradient`); w x I w goes by products of w, so that differences of
        principal moments are constants.

        Args:
            a: (6,) plain acceleration of the origin.
            w: (3,) angular velocity.
            K: (3, 3).
        """
        x, y, z = w.tolist()
        xx, yy, zz, xy, xz, yz = x * x, y * y, z * z, x * y, x * z, y * z
        (Ixx, Ixy, Ixz), (_, Iyy, Iyz), (_, _, Izz) = self.I.tolist()
        turning = array(
            [
                (Izz - Iyy) * yz + Iyz * (yy - zz) + Ixz * xy - Ixy * xz,
                (Ixx - Izz) * xz + Ixz * (zz - xx) + Ixy * yz - Iyz * xy,
                (Iyy - Ixx) * xy + Ixy * (xx - yy) + Iyz * xz - Ixz * yz,
            ]
        )
        moment = self.I @ a[:3] + turning + cross(self.h, a[3:])
        return concatenate([moment, self.m * a[3:] + K @ self.h])

    def plus(self, other: RigidInertia) -> RigidInertia:
        """Return the inertia of two bodies welded together, same point and axes."""
        return RigidInertia(self.m + other.m, self.h + other.h, self.I + other.I)

    def minus(self, other: RigidInertia) -> RigidInertia:
        """Return the inertia that remains when a body is removed, same point and axes."""
        return RigidInertia(self.m - other.m, self.h - other.h, self.I - other.I)

    def moved(self, R: Array, l: Array) -> RigidInertia:
        """Return the inertia in axes turned by R about the point at -l (new axes).

        phi M phi^T after the rotation: I' = I - l h^T - h l^T + 2 (h.l) 1 + m (l.l 1 - l l^T).
        """
        h = R @ self.h
        first = h + self.m * l  # first moment about the new point
        I = R @ self.I @ R.T - outer(l, h) - outer(first, l)
        return RigidInertia(self.m, first, mirrored(I + (l @ h + first @ l) * np.eye(3)))

    def symmetric(self) -> Symmetric6:
        """Return the (6, 6) matrix as its three different (3, 3) blocks."""
        return Symmetric6(self.I, skew(self.h), self.m * np.eye(3))

    @property
    def parameters(self) -> Array:
        """(10,) m, h and the entries xx, xy, xz, yy, yz, zz of I; see `PARAMETERS`."""
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = self.I.tolist()
        return concatenate([array([self.m]), self.h, array([xx, xy, xz, yy, yz, zz])])


def of_parameters(parameters: Array) -> RigidInertia:
    """Return the inertia with ten parameters, (10,) as `RigidInertia.parameters` has them."""
    m, hx, hy, hz, xx, xy, xz, yy, yz, zz = parameters.tolist()
    return RigidInertia(m, array([hx, hy, hz]), array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))


PARAMETERS = ("m", "hx", "hy", "hz", "Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz")  # kg, kg m, kg m^2
NO_INERTIA = RigidInertia(0.0, np.zeros(3), np.zeros((3, 3)))


def turned(inertia: Array, R: Array) -> Array:
    """Return R J R^T: a rotational inertia (3, 3) in the axes to which R maps."""
    return product(product(R, inertia), R.T)


def about_origin(mass: Scalar, com: Array, inertia: Array) -> RigidInertia:
    """Return the inertia about the body's origin from mass, mass centre and inertia about it."""
    h = mass * com
    return RigidInertia(mass, h, mirrored(inertia + dot(com, h) * np.eye(3) - outer(com, h)))


def welded(parts: list[tuple[float, Array, Array]]) -> tuple[float, Array, Array]:
    """Return mass, mass centre and inertia about it of bodies welded together, each given by the same three."""
    m = sum(part[0] for part in parts)
    c = sum((m_i / m * c_i for m_i, c_i, _ in parts), np.zeros(3)) if m > 0 else np.zeros(3)
    if len(parts) == 1:
        c = parts[0][1]
    J = np.zeros((3, 3))
    for m_i, c_i, J_i in parts:
        d = c_i - c
        J = J + J_i + m_i * (dot(d, d) * np.eye(3) - np.outer(d, d))
    return m, c + 0.0, J + 0.0  # no -0.0
