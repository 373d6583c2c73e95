"""The held object in motion: M(C) alpha(C) + b(C) = f(C) (2.4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.model.held_object import HeldObject
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, array, concatenate
from holdfast.spatial.spatial_vector import centripetal, shift_twist, shift_wrench
from holdfast.spatial.symmetric import Symmetric6
from holdfast.spatial.vector import cross


@dataclass(frozen=True, eq=False)
class ObjectMotion:
    """The object at one instant, about C, world axes.

    Attributes:
        inertia: M(C).
        mobility: M(C)^-1.
        bias: (6,) b(C) less the external wrench.
        free_acceleration: (6,) -M(C)^-1 b(C), less [0; g].
    """

    inertia: Symmetric6
    mobility: Symmetric6
    bias: Array
    free_acceleration: Array


def object_motion(body: HeldObject, frame: Pose, twist: Array, wrench: Array) -> ObjectMotion:
    """Return inertia, mobility and bias of the object.

    M(C)^-1 and -M(C)^-1 b(C) are built at the mass centre, where they are block diagonal,
    and carried to C: nothing is subtracted, however far C is from the mass centre.

    Args:
        body: the object.
        frame: its pose (origin C) in the world.
        twist: (6,) of C, world axes.
        wrench: (6,) external wrench about C, world axes.
    """
    R, w = frame.R, twist[:3]
    p = R @ body.com  # C to mass centre
    I, inverse = R @ body.inertia @ R.T, R @ symmetric_inverse(body.inertia) @ R.T
    none, unit = np.zeros((3, 3)), np.eye(3)
    spin = cross(w, I @ w)
    at_com = shift_wrench(-p, wrench)
    free = concatenate([inverse @ (at_com[:3] - spin), at_com[3:] / body.mass])
    back = centripetal(w, -p)
    return ObjectMotion(
        Symmetric6(I, none, body.mass * unit).inertia_shifted(p),
        Symmetric6(inverse, none, (1.0 / body.mass) * unit).mobility_shifted(-p),
        shift_wrench(p, concatenate([spin, body.mass * centripetal(w, p)])) - wrench,
        shift_twist(-p, free) + concatenate([np.zeros(3), back]),
    )


def symmetric_inverse(S: Array) -> Array:
    """Return the inverse of a symmetric positive definite 3x3 matrix, by cofactors."""
    (a, b, c), (_, d, e), (_, _, f) = S.tolist()
    A, B, C = d * f - e * e, c * e - b * f, b * e - c * d
    D, E, F = a * f - c * c, b * c - a * e, a * d - b * b
    det = a * A + b * B + c * C
    return array([[A, B, C], [B, D, E], [C, E, F]]) / det
