"""The equations by which an arm enters the object's filter: rows C alpha(G) = r - R lambda.

Whether a pivot is only the rounding of zero is judged by the size of the terms in its sum, not by the size of the sum,
because a row along which an arm cannot move consists of rounding alone. The sizes are traces of the angular and of the
linear block, so the decision depends neither on the axes nor on the units.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.closed.tip_response import TipResponse
from holdfast.spatial.scalar import Array, Scalar, array
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench
from holdfast.spatial.symmetric import Symmetric6
from holdfast.spatial.vector import outer


@dataclass(frozen=True, eq=False)
class Measurement:
    """The rows of one arm, along contact axes; for a rigid grasp along world axes and about G, with C = 1.

    Attributes:
        C: K A, (rows, 6).
        R: K Lambda K^T, the "measurement noise".
        r: (rows,) K (alpha_f + g - a).
        X: (rows, c) K X, what the accelerations beta of a trunk's columns add to r; (rows, 0) without columns.
        extent: (4,) sizes of the arm's mobility at the contact point: angular [1/(kg m^2)]; linear, including rotations
            with the length of the arm as lever; linear [1/kg]; and the squared distance of the point from G [m^2].
        angular: for each row, whether it is a moment.
        most: number of the arm's joints, which the rank of R cannot exceed.
        carried: whether the rows are those of a rigid grasp, which determine all of alpha(G).
        held: (rows,) 1 for imposed rows, 0 for omitted rows, which are zero in C, R and r; None if the rows have not
            been chosen.
    """

    C: Array
    R: Array
    r: Array
    X: Array
    extent: Array
    angular: tuple[bool, ...]
    most: int
    carried: bool
    held: Array | None = None

    @property
    def parallel(self) -> bool:
        """Whether the filter includes the arm by a parallel sum, before the others."""
        return self.carried and self.most >= len(self.angular)

    def own_sizes(self) -> Array:
        """Return the sizes of the terms in the diagonal of R, (rows,)."""
        return array([self.extent[0] if angular else self.extent[1] for angular in self.angular])

    def pivot_sizes(self, of: Array) -> Array:
        """Return the sizes of the terms in the diagonal of S = R + C P C^T, (rows,).

        Args:
            of: (3,) sizes of P about G, as `size_at_centre` returns them for an arm.
        """
        return self.own_sizes() + self._rows(of[0], of[1])

    def typical_pivots(self, of: Array) -> Array:
        """Return typical pivots of a regular S, (rows,), with which its condition is judged."""
        return np.diag(self.R) + self._rows(of[0], of[2]) / 3.0

    def _rows(self, turning: Scalar, moving: Scalar) -> Array:
        """Return the contribution of a mobility about G to the size of each row, (rows,)."""
        along = moving + self.extent[3] * turning
        return array([turning if angular else along for angular in self.angular])


def measurement(c: Contact, tip: TipResponse) -> Measurement:
    """Return the measurement of alpha(G) by one arm.

    Args:
        c: its contact, with G in place of C.
        tip: its tip response.
    """
    r, columns = tip.free_acceleration + c.g - c.a, [] if tip.base is None else tip.base.X.T
    turning, moving = block_sizes(tip.mobility)
    summed = moving + tip.length * tip.length * turning  # the arm's length bounds its levers
    lever, most = c.offset @ c.offset, len(tip.pivots)
    if len(c.rows) == 6 and c.held is None:
        R = tip.mobility.mobility_shifted(-c.offset).dense()
        extent = array([turning, summed + lever * turning, moving + lever * turning, 0.0 * turning])
        X = array([shift_twist(-c.offset, column) for column in columns]).reshape(-1, 6).T
        return Measurement(np.eye(6), R, shift_twist(-c.offset, r), X, extent, ANGULAR, most, True)
    rows = list(c.rows)
    C = array([shift_wrench(c.offset, row) for row in c.K]).reshape(-1, 6)  # (K A)^T = A^T K^T
    kind, R = c.grasp.of_kind, tip.mobility.rotated(c.R.T).dense()
    R = kind.along(kind.along(R).T)[rows][:, rows]
    r, X = c.transmitted(r), array([c.transmitted(column) for column in columns]).reshape(len(columns), len(rows)).T
    held = None if c.held is None else c.held[rows]
    if held is not None:
        C, R, r, X = (C.T * held).T, R * outer(held, held), r * held, (X.T * held).T
    angular = tuple(kind.angular[i] for i in rows)
    return Measurement(C, R, r, X, array([turning, summed, moving, lever]), angular, most, False, held)


def seen_along(c: Contact, m: Measurement, gap: Array) -> Array:
    """Return r of a measurement, (rows,), for another gap (6,) about the contact point, world axes."""
    if m.carried:
        return shift_twist(-c.offset, gap)
    r = c.transmitted(gap)
    return r if m.held is None else r * m.held


ANGULAR = (True, True, True, False, False, False)


def block_sizes(mobility: Symmetric6) -> Array:
    """Return the traces of the angular and of the linear block, (2,)."""
    return array([np.trace(mobility.aa), np.trace(mobility.ll)])


def size_at_centre(extent: Array) -> Array:
    """Return the sizes of an arm's mobility about G, (3,): angular, linear with levers, linear."""
    turning, summed, moving, lever = extent
    return array([turning, summed + lever * turning, moving + lever * turning])
