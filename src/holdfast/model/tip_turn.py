"""Measures of the angles that a grasp closes: of the tip's attitude in contact axes, (3, 3)."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array, Scalar, arctan2, array, concatenate, maximum, sqrt
from holdfast.spatial.vector import axial, cross

X, _, Z = np.eye(3)


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


def axis_turn(tip: Array) -> Array:
    """Return the shortest rotation vector from the tip's x axis to the contact frame's, (3,) [rad]."""
    return rotation.align(tip[:, 0], X)


def axis_opening(tip: Array) -> Array:
    """Return the shortest rotation vector from the contact frame's x axis to the tip's, with length sine, (3,)."""
    return cross(X, tip[:, 0])


def axis_cosine(tip: Array) -> Scalar:
    """Return the cosine of the angle between the two x axes."""
    return tip[0, 0]


def normal_turn(tip: Array) -> Array:
    """Return the shortest rotation vector from the tip's z axis to the contact frame's, (3,) [rad]."""
    return rotation.align(tip[:, 2], Z)


def normal_opening(tip: Array) -> Array:
    """Return the shortest rotation vector from the contact frame's z axis to the tip's, with length sine, (3,)."""
    return cross(Z, tip[:, 2])


def normal_cosine(tip: Array) -> Scalar:
    """Return the cosine of the angle between the two z axes."""
    return tip[2, 2]


def cross_turn(tip: Array) -> Array:
    """Return the rotation about z that makes the arms of a cardan cross perpendicular, in its axes, (3,) [rad]."""
    sine = tip[1, 0]
    return array([0.0, 0.0, -arctan2(sine, sqrt(maximum((1.0 - sine) * (1.0 + sine), 0.0)))])


def cross_opening(tip: Array) -> Array:
    """Return the opposite rotation, with the sine as its length, (3,)."""
    return concatenate([np.zeros(2), [tip[1, 0]]])


FULL = TipTurn(full_turn, full_opening, rotation.cosine)
ABOUT_X = TipTurn(axis_turn, axis_opening, axis_cosine)
ABOUT_Z = TipTurn(normal_turn, normal_opening, normal_cosine)
CROSS = TipTurn(cross_turn, cross_opening, no_cosine)  # its angle never exceeds a quarter turn
