"""The inertia and bias of the held object: M(C) alpha(C) + b(C) = f(C) (2.4)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from holdfast.model.held_object import HeldObject
from holdfast.model.link import Link
from holdfast.spatial.linalg import forward_substitution, ldl
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, array, concatenate
from holdfast.spatial.spatial_vector import centripetal, shift_twist, shift_wrench
from holdfast.spatial.symmetric import Symmetric6, mirrored
from holdfast.spatial.vector import cross


class FreeBody(NamedTuple):
    """The object without its arms, about its mass centre G, in world axes.

    About G the mobility is block diagonal. The angular mobility of an object close to a point mass, which is nearly
    infinite, therefore does not affect the digits of its linear mobility. About another point, one would have to be
    subtracted from the other.

    Attributes:
        centre: (3,) p, from C to G [m].
        centripetal: (3,) w x (w x p), the acceleration of G relative to C due to the angular velocity.
        inertia: M(G).
        mobility: M(G)^-1.
        D: six factors > 0 of the mobility, sum D w w^T.
        w: six columns of the mobility, (6,) each.
        acceleration: (6,) acceleration of G without arms and external wrench, minus [0; g].
        wrench: (6,) external wrench about G. It is not included in `acceleration`, because M(G)^-1 of a light object
            would make that huge, and the arms would cancel most of it.
    """

    centre: Array
    centripetal: Array
    inertia: Symmetric6
    mobility: Symmetric6
    D: list[Scalar]
    w: list[Array]
    acceleration: Array
    wrench: Array

    def at_rest(self) -> FreeBody:
        """Return the same object at rest and without an external wrench."""
        none = np.zeros(6)
        return self._replace(centripetal=np.zeros(3), acceleration=none, wrench=none)


@dataclass(frozen=True, eq=False)
class ObjectMotion:
    """The object at one instant, about C, world axes.

    Attributes:
        inertia: M(C).
        mobility: M(C)^-1.
        bias: (6,) b(C).
        free_acceleration: (6,) -M(C)^-1 b(C), the acceleration without arms and external wrench, minus [0; g].
        wrench: (6,) external wrench.
        free: the same object about its mass centre, for the object's filter.
    """

    inertia: Symmetric6
    mobility: Symmetric6
    bias: Array
    free_acceleration: Array
    wrench: Array
    free: FreeBody


def object_motion(body: HeldObject, frame: Pose, twist: Array, wrench: Array) -> ObjectMotion:
    """Return the inertia, mobility and bias of the object.

    M(C)^-1 and -M(C)^-1 b(C) are computed at the mass centre, where M^-1 is block diagonal, and then shifted to C. No
    terms cancel, however far C is from the mass centre.

    Args:
        body: the object.
        frame: its pose (origin C) in the world.
        twist: (6,) twist of C, world axes.
        wrench: (6,) external wrench about C, world axes.
    """
    R, free = frame.R, free_body(body, frame.R, twist[:3])
    spin = R @ _spin(body, R, twist[:3])
    return ObjectMotion(
        free.inertia.inertia_shifted(free.centre),
        free.mobility.mobility_shifted(-free.centre),
        shift_wrench(free.centre, concatenate([spin, body.mass * free.centripetal])),
        acceleration_at_C(free.centre, free.centripetal, free.acceleration),
        wrench,
        free._replace(wrench=shift_wrench(-free.centre, wrench)),
    )


def free_body(body: HeldObject | Link, R: Array, w: Array) -> FreeBody:
    """Return a body about its mass centre, without an external wrench.

    Args:
        body: mass, mass centre and inertia.
        R: (3, 3) its attitude in the world.
        w: (3,) its angular velocity, world axes.
    """
    p = R @ body.com  # from the origin to the mass centre
    inverse = symmetric_inverse(body.inertia)
    falling = concatenate([-(R @ (inverse @ _spin(body, R, w))), np.zeros(3)])  # the mass centre is not accelerated
    none, unit = np.zeros((3, 3)), np.eye(3)
    inertia = Symmetric6(mirrored(R @ body.inertia @ R.T), none, body.mass * unit)
    mobility = Symmetric6(mirrored(R @ inverse @ R.T), none, (1.0 / body.mass) * unit)
    return FreeBody(p, centripetal(w, p), inertia, mobility, *_factors(body, R), falling, np.zeros(6))


def _spin(body: HeldObject | Link, R: Array, w: Array) -> Array:
    """Return w x I w, (3,), in the axes of the body."""
    turning = w @ R
    return cross(turning, body.inertia @ turning)


def acceleration_at_C(centre: Array, centripetal: Array, alpha: Array) -> Array:
    """Return alpha(C), (6,), for an acceleration alpha of the mass centre; see `FreeBody` for the other arguments."""
    return shift_twist(-centre, alpha) - concatenate([np.zeros(3), centripetal])


def _factors(body: HeldObject | Link, R: Array) -> tuple[list[Scalar], list[Array]]:
    """Return D and w with M(G)^-1 = sum D w w^T: three translations of the mass centre, then three rotations about it.

    I = L diag(d) L^T along object axes, so I^-1 is the sum of u u^T / d over the columns u of L^-T.
    """
    factors = ldl(body.inertia, np.zeros(3))  # positive definite: every pivot counts
    turns = [concatenate([R @ u, np.zeros(3)]) for u in forward_substitution(factors.L, np.eye(3))]
    pushes = [concatenate([np.zeros(3), axis]) for axis in np.eye(3)]
    return [1.0 / body.mass] * 3 + [1.0 / d for d in factors.pivots], pushes + turns


def symmetric_inverse(S: Array) -> Array:
    """Return the inverse of a symmetric positive definite 3x3 matrix, by cofactors."""
    (a, b, c), (_, d, e), (_, _, f) = S.tolist()
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    D, E, F = a * f - c * c, b * c - a * e, a * d - b * b
    det = a * A + b * B + c * C
    return array([[A, B, C], [B, D, E], [C, E, F]]) / det
