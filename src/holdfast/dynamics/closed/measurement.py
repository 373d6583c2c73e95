"""One arm as the object's filter sees it: rows C alpha(C) = r - R lambda."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.closed.tip_response import TipResponse
from holdfast.spatial.scalar import Array, Scalar, array, maximum, minimum, where
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench
from holdfast.spatial.symmetric import Symmetric6

# Arms less mobile than this part of the object's own mobility set no scale for its pivots.
LIGHTEST_OBJECT = 1e-10


class Measurement(NamedTuple):
    """Rows along contact axes; for a rigid grasp about C along world axes, where C = 1.

    Attributes:
        C: K A, (rows, 6).
        R: K Lambda K^T, the "measurement noise".
        r: (rows,) K (alpha_f + g - a).
        object_size: (rows,) diagonal of C M(C)^-1 C^T: how the free object moves.
        most: the arm's joint count, which the rank of R cannot exceed.
        carried: whether the rows are all of alpha(C).
    """

    C: Array
    R: Array
    r: Array
    object_size: Array
    most: int
    carried: bool


class Step(NamedTuple):
    """What is left of one arm for the way back.

    Attributes:
        back: s (6,), the wrench at C of everything behind -> the arm's own, C^T lambda.
        kept: how many of its rows are independent of those before.
        weakest: the smallest pivot kept, relative to its scale.
    """

    back: Callable[[Array], Array]
    kept: Scalar
    weakest: Scalar


def measurement(c: Contact, tip: TipResponse, mobility: Symmetric6) -> Measurement:
    """Return one arm's measurement of alpha(C), `mobility` being M(C)^-1."""
    r = tip.free_acceleration + c.g - c.a
    if c.grasp.kind == "rigid":
        R = tip.mobility.mobility_shifted(-c.offset).dense()
        size = np.concatenate([np.diag(mobility.aa), np.diag(mobility.ll)])
        return Measurement(np.eye(6), R, shift_twist(-c.offset, r), size, len(tip.pivots), True)
    rows = list(c.grasp.transmitted)
    C = array([shift_wrench(c.offset, row) for row in c.K])  # (K A)^T = A^T K^T
    R = tip.mobility.rotated(c.R.T).dense()[rows][:, rows]
    object_size = array([row @ mobility.apply(row) for row in C])
    return Measurement(C, R, c.transmitted(r), object_size, len(tip.pivots), False)


def mobility_ratio(m: Measurement) -> Scalar:
    """Return the arm's largest mobility over the object's own, row by row, without units."""
    size: Scalar = 0.0
    of: Scalar = 1.0
    for arm_size, object_size in zip(np.diag(m.R), m.object_size, strict=True):
        larger = arm_size * of > size * object_size  # of two ratios, with one division in the end
        size, of = where(larger, arm_size, size), where(larger, object_size, of)
    return size / of


def object_share(share: Scalar, ratio: Scalar) -> Scalar:
    """Return which part of the object's mobility sets the scale of pivots, one more arm considered.

    What the arms leave of the object's mobility is of the size of their own; a light object's
    M(C)^-1 is far larger, and as a scale would call sound rows null. Hence min(1, the arms'
    largest ratio), `LIGHTEST_OBJECT` to begin with.
    """
    return minimum(maximum(share, ratio), 1.0)
