"""Measures of the angles that a grasp closes: of the tip's attitude in contact axes, (3, 3)."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array, Scalar, arctan2, array, concatenate, maximum, sqrt
from holdfast.spatial.vector import axial, cross


class TipTurn(NamedTuple):
    """Three functions of the tip's attitude in contact axes, (3, 3).

    Attributes:
        closing: returns the rotation vector that closes the angles, (3,) [rad].
        opening: returns the opposite vector, with the sine of the angle as its length, (3,).
        cosine: returns the cosine of the angle. A negative one belongs to an angle that its sine does not show.
    """

    closing: Callable[[Array], Array]
    opening: Callable[[Array], Array]
    cosine: Callable[[Array], Scalar]


def no_turn(tip: Array) -> Array:
    """Return zeros (3,), because the attitude of the tip (3, 3) is free."""
    return np.zeros(3)


def no_cosine(tip: Array) -> float:
    """Return 1: there is no angle, or none beyond a quarter turn, which its sine would not show."""
    return 1.0


def full_turn(tip: Array) -> Array:
    """Return the rotation vector from the tip's attitude to the contact frame, (3,) [rad]."""
    return rotation.log(tip.T)


def full_opening(tip: Array) -> Array:
    """Return the rotation vector from the contact frame to the tip's attitude, with the sine as its length, (3,)."""
    return 0.5 * axial(tip)


def turn_of_axis(k: int) -> TipTurn:
    """Return the functions of the shortest turn between axis k of the tip and that of the contact frame."""
    axis = np.eye(3)[k]
    return TipTurn(
        closing=lambda tip: rotation.align(tip[:, k], axis),
        opening=lambda tip: cross(axis, tip[:, k]),
        cosine=lambda tip: tip[k, k],
    )


def cross_turn(tip: Array) -> Array:
    """Return the rotation about z that makes the arms of a cardan cross perpendicular, in its axes, (3,) [rad]."""
    sine = tip[1, 0]
    return array([0.0, 0.0, -arctan2(sine, sqrt(maximum((1.0 - sine) * (1.0 + sine), 0.0)))])


def cross_opening(tip: Array) -> Array:
    """Return the opposite rotation, with the sine as its length, (3,)."""
    return concatenate([np.zeros(2), [tip[1, 0]]])


FULL = TipTurn(full_turn, full_opening, rotation.cosine)
ABOUT_X = turn_of_axis(0)
ABOUT_Z = turn_of_axis(2)
CROSS = TipTurn(cross_turn, cross_opening, no_cosine)  # its angle never exceeds a quarter turn
