"""The laws of Signorini and Coulomb in the object's freedoms, and how far forces are from satisfying them.

    V = V0 + P sum_j C_j^T lambda_j,     u_j = b_j + C_j (V - V0)

    open:   lambda = 0,  u_n >= 0
    sticks: u = 0,       |lambda_t| <= mu lambda_n
    slips:  u_n = 0,     lambda_t = -mu lambda_n u_t / |u_t|

With P = L L^T the unknown is z = L^T sum C_j^T lambda_j, which has at most six entries. A contact that slides already
(u_t != 0, and u is an acceleration) has the force (n - mu t) lambda_n with its direction t known: it is a contact
without friction whose force acts along other rows than those of its velocity. A compliant contact obeys the laws in
u + compliance lambda instead of u.

All components here are in the order [n, t1, t2], so that a force is a point of the second-order cone. A patch that may
spin about its normal has a fourth: its moment divided by, and its rate of turn times, its torsion radius e. With these,
the limit surface |(lambda_t, m_n / e)| <= mu lambda_n is a cone of the same law.

References: De Saxce and Feng, "The bipotential method", 1998; Acary and Brogliato, "Numerical Methods for Nonsmooth
Dynamical Systems", 2008; docs/theory/contact_with_the_world.md.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.spatial.linalg import largest_first
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, each, maximum, reciprocal, scan, sqrt, where
from holdfast.spatial.vector import largest

TINY = 1e-200  # added to sizes by which is divided
LEAST_MOBILITY = 1e-9  # of a contact's point, relative to the largest of all contacts
UNIT_ROUNDING = 2.0**-52
NORMAL_FIRST = [2, 0, 1]
TANGENTS_FIRST = [1, 2, 0]


def normal_first(x: Array) -> Array:
    """Return what has components [t1, t2, n] or [t1, t2, n, spin] along its first axis with the normal one first."""
    return x[[*NORMAL_FIRST, *range(3, len(x))]]


def tangents_first(x: Array) -> Array:
    """Return the inverse of `normal_first`."""
    return x[[*TANGENTS_FIRST, *range(3, len(x))]]


class ReducedContact(NamedTuple):
    """One contact in the object's freedoms; r of them, axes [n, t1, t2].

    Attributes:
        by_z: (3, r) rows of the velocity by z, C L.
        along: (3, r) rows along which the force acts; those of the velocity, but for a contact that slides already.
        free: (3,) velocity without contact forces, b.
        friction: mu; 0 for a contact that slides already.
        gauge: a typical mobility, by which forces are compared with velocities.
        compliance: velocity that a unit of force gives way; 0 for a rigid contact.
        slide: (2,) mu t of a contact that slides already, else 0.
    """

    by_z: Array
    along: Array
    free: Array
    friction: Scalar
    gauge: Scalar
    compliance: Scalar
    slide: Array

    def velocity(self, z: Array) -> Array:
        """Return u."""
        return self.free + self.by_z @ z

    def whole_force(self, x: Array) -> Array:
        """Return the force on the object, which for a contact that slides already has tangential components."""
        return concatenate([x[:1], x[1:] - x[0] * self.slide])


def reduced_contacts(
    mobility: Array, rows: Array, free: Array, friction: Array, compliance: Array, slide: Array
) -> tuple[Array, list[ReducedContact]]:
    """Return L (6, 6) with P = L L^T, null columns for null pivots, and the contacts in z.

    Args:
        mobility: (6, 6) P of the object in the chain.
        rows: (k, 3, 6) C, axes [t1, t2, n].
        free: (k, 3) b, axes [t1, t2, n].
        friction: (k,) mu.
        compliance: (k,) 0 for rigid contacts.
        slide: (k, 2) unit direction t of contacts that slide already, else 0.
    """
    d, w = largest_first(mobility, np.diag(mobility) + TINY)  # a null row must not be chosen first
    L = array([sqrt(pivot) * column for pivot, column in zip(d, w, strict=True)]).T

    def reduced(C: Array) -> tuple[Array, Scalar]:
        B = normal_first(C) @ L
        return B, ((B * B).sum()) * (1.0 / 3.0)

    parts = each(reduced, rows)
    most = largest(own for _, own in parts)

    def contact(part: tuple[Array, Scalar], b: Array, mu: Scalar, give: Scalar, t: Array) -> ReducedContact:
        B, own = part
        slides = (t @ t) > 0.0
        along = concatenate([B[0] - mu * (t @ B[1:])])
        return ReducedContact(
            B,
            array([along, *B[1:]]),
            normal_first(b),
            where(slides, 0.0, mu),
            maximum(own, LEAST_MOBILITY * most) + TINY,
            give,
            mu * t,
        )

    return L, each(contact, parts, free, friction, compliance, slide)


def unknown(contacts: list[ReducedContact], forces: list[Array]) -> Array:
    """Return z of some forces."""
    start = 0.0 * contacts[0].by_z[0]
    return scan(lambda z, c, x: (z + x @ c.along, None), start, contacts, forces)[0]


def motion_with(contacts: list[ReducedContact], forces: list[Array]) -> tuple[Array, list[Array]]:
    """Return z of some forces, and the velocities of all contacts with them."""
    z = unknown(contacts, forces)
    return z, each(lambda c: c.velocity(z), contacts)


def violation(contacts: list[ReducedContact], forces: list[Array], velocities: list[Array] | None = None) -> Scalar:
    """Return how far forces are from the laws, relative to the largest free velocity.

    The natural map of the laws as a complementarity of cones, |g x - proj(g x - u - mu |u_t| n)| with the gauge g, is
    a velocity. (Relative to the forces, large internal forces would hide that contacts penetrate; what their rounding
    may hide is added.)

    Args:
        contacts: the contacts.
        forces: (3,) of every contact.
        velocities: those with these forces, if they are known.
    """
    velocities = motion_with(contacts, forces)[1] if velocities is None else velocities

    def of_contact(c: ReducedContact, x: Array, rigid: Array) -> tuple[Scalar, Scalar]:
        u = rigid + c.compliance * x
        slip = c.friction * sqrt(u[1:] @ u[1:])
        pressed = c.gauge * x
        y = pressed - u - concatenate([[slip], np.zeros(len(x) - 1)])
        return largest(pressed - in_friction_cone(y, c.friction)) + UNIT_ROUNDING * largest(pressed), size_of(c)

    found = each(of_contact, contacts, forces, velocities)
    return largest(off for off, _ in found) * reciprocal(largest(size for _, size in found) + TINY)


def size_of(c: ReducedContact) -> Scalar:
    """Return the size of a contact's free velocity; without friction only the normal matters."""
    return where(c.friction > 0.0, largest(c.free), abs(c.free[0]))


def in_friction_cone(y: Array, mu: Scalar) -> Array:
    """Return the nearest point of the cone |x_t| <= mu x_n, (3,)."""
    size = sqrt(y[1:] @ y[1:])
    inside, polar = size <= mu * y[0], mu * size <= -y[0]  # both are true below the apex of a cone without width
    n = where(polar, 0.0, where(inside, y[0], (y[0] + mu * size) * reciprocal(1.0 + mu * mu)))
    ratio = where(polar, 0.0, where(inside, 1.0, mu * n * reciprocal(where(size > 0.0, size, 1.0))))
    return concatenate([[n], ratio * y[1:]])
