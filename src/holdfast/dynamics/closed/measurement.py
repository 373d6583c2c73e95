"""One arm as the object's filter sees it: rows C alpha(G) = r - R lambda.

How large a pivot may be that is only the rounding of zero follows from the sizes of what was summed,
not from what the sum came to: a row along which an arm cannot move is itself rounding. The sizes are
traces of the angular and of the linear block, so they depend neither on the axes nor on the units.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.closed.tip_response import TipResponse
from holdfast.spatial.scalar import Array, Scalar, array
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench
from holdfast.spatial.symmetric import Symmetric6
from holdfast.spatial.vector import outer


class Measurement(NamedTuple):
    """Rows along contact axes; for a rigid grasp about G along world axes, where C = 1.

    Attributes:
        C: K A, (rows, 6).
        R: K Lambda K^T, the "measurement noise".
        r: (rows,) K (alpha_f + g - a); of an arm on a trunk (rows, 1 + c) [r | K X], r + K X beta for accelerations
            beta of the trunk's columns.
        extent: (4,) how mobile the arm is where it measures: angular [1/(kg m^2)], linear with what turns
            at the end of the arm's length, linear [1/kg], and the squared distance of that point from G [m^2].
        angular: which rows are moments.
        most: the arm's joint count, which the rank of R cannot exceed.
        carried: whether the rows are all of alpha(G).
        held: (rows,) 1 for the rows that are held, 0 for those left out, which are zero in C, R and r; None where
            nothing is known of them.
    """

    C: Array
    R: Array
    r: Array
    extent: Array
    angular: tuple[bool, ...]
    most: int
    carried: bool
    held: Array | None = None

    @property
    def parallel(self) -> bool:
        """Whether the filter takes the arm as a parallel sum, before the others."""
        return self.carried and self.most >= len(self.r)

    def own_sizes(self) -> Array:
        """Return (rows,) the sizes of what R's diagonal was summed from."""
        return array([self.extent[0] if angular else self.extent[1] for angular in self.angular])

    def pivot_sizes(self, of: Array) -> Array:
        """Return (rows,) the sizes of what the diagonal of S = R + C P C^T was summed from.

        Args:
            of: (3,) how mobile P is about G, as `size_at_centre` says it of an arm.
        """
        return self.own_sizes() + self._rows(of[0], of[1])

    def typical_pivots(self, of: Array) -> Array:
        """Return (rows,) how large the pivots of S are where nothing is singular, for its condition."""
        return np.diag(self.R) + self._rows(of[0], of[2]) / 3.0

    def _rows(self, turning: Scalar, moving: Scalar) -> Array:
        """Return (rows,) the traces of a mobility about G as they count for each row."""
        along = moving + self.extent[3] * turning
        return array([turning if angular else along for angular in self.angular])


BackSubstitution = Callable[..., Array]  # s (6,), beta (6,) or None -> an arm's wrench at G, (6,)


class Update(NamedTuple):
    """What is left of one arm for the way back.

    Attributes:
        back_substitute: s (6,), the wrench at G of everything behind, and beta (c,) of the trunk's columns, or None ->
            the arm's own, C^T lambda.
        again: other x and r -> x after the arm, and the way back, by the factors at hand.
        kept: how many of its rows are independent of those before.
        weakest: the smallest pivot kept, relative to a typical one.
        independent: (rows,) 1 for the rows that are kept, where the contact says which are held.
        on_trunk: (c, 1 + c) [load | inertia] that the grasp adds to what the trunk's columns feel: E^T S^-1 (r - C x),
            of a mounted arm.
    """

    back_substitute: BackSubstitution
    again: Callable[[Array, Array], tuple[Array, BackSubstitution]]
    kept: Scalar
    weakest: Scalar
    independent: Array | None = None
    on_trunk: Array | None = None


def of_beta(columns: Array, beta: Array | None) -> Array:
    """Return x + X beta of columns [x | X], (rows, 1 + c); x itself, (rows,), where there is no trunk."""
    return columns if columns.ndim == 1 else columns[:, 0] + columns[:, 1:] @ beta


def with_columns(first: Array, tip: TipResponse) -> Array:
    """Return (6, 1 + c) a tip's acceleration, and what it has of a trunk's; (6,) the acceleration without a trunk."""
    return first if tip.base is None else np.column_stack([first, tip.base.X])


def column_wise(f: Callable[[Array], Array], columns: Array) -> Array:
    """Return f of a 6-vector, or of each column of a (6, m) matrix."""
    return f(columns) if columns.ndim == 1 else array([f(column) for column in columns.T]).T


def measurement(c: Contact, tip: TipResponse) -> Measurement:
    """Return one arm's measurement of alpha(G).

    Args:
        c: its grasp, seen from G.
        tip: its answer at its tip.
    """
    r = with_columns(tip.free_acceleration + c.g - c.a, tip)
    turning, moving = block_sizes(tip.mobility)
    summed = moving + tip.length * tip.length * turning  # levers are sums of links
    lever, most = c.offset @ c.offset, len(tip.pivots)
    if len(c.rows) == 6 and c.held is None:
        R = tip.mobility.mobility_shifted(-c.offset).dense()
        extent = array([turning, summed + lever * turning, moving + lever * turning, 0.0 * turning])
        at_centre = column_wise(lambda one: shift_twist(-c.offset, one), r)
        return Measurement(np.eye(6), R, at_centre, extent, ANGULAR, most, True)
    rows = list(c.rows)
    C = array([shift_wrench(c.offset, row) for row in c.K]).reshape(-1, 6)  # (K A)^T = A^T K^T
    kind, R = c.grasp.of_kind, tip.mobility.rotated(c.R.T).dense()
    R = kind.along(kind.along(R).T)[rows][:, rows]
    r = column_wise(c.transmitted, r)
    held = None if c.held is None else c.held[rows]
    if held is not None:
        C, R, r = (C.T * held).T, R * outer(held, held), (r.T * held).T
    angular = tuple(kind.angular[i] for i in rows)
    return Measurement(C, R, r, array([turning, summed, moving, lever]), angular, most, False, held)


def seen_along(c: Contact, m: Measurement, gap: Array) -> Array:
    """Return (rows,) r of a measurement for another K r, given as a 6-vector about the contact point, world axes."""
    if m.carried:
        return shift_twist(-c.offset, gap)
    r = c.transmitted(gap)
    return r if m.held is None else r * m.held


ANGULAR = (True, True, True, False, False, False)


def block_sizes(mobility: Symmetric6) -> Array:
    """Return (2,) the traces of the angular and of the linear block."""
    return array([np.trace(mobility.aa), np.trace(mobility.ll)])


def size_at_centre(extent: Array) -> Array:
    """Return (3,) how mobile an arm of this extent is about G: angular, linear as summed, linear."""
    turning, summed, moving, lever = extent
    return array([turning, summed + lever * turning, moving + lever * turning])
