"""The joints of a forest, as one table: displacement and rate map of every kind; no other code depends on their names.

A joint displaces the body's frame by (Q, d) in the joint's frame on the parent. Its rates qd move the body relative to
the parent by the twist (A qd, B qd) about the body's origin, in the axes of that frame, where A and B are constant.
Hence a joint with m freedoms needs no other equations than a joint with one (docs/theory/tree.md).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array, Scalar, concatenate, cos, sin
from holdfast.spatial.vector import cross, outer, skew

_NONE = np.zeros(3)


@dataclass(frozen=True)
class JointKind:
    """The properties of one kind of joint.

    Attributes:
        turning: per freedom, whether its rate is an angular velocity [rad/s]; otherwise it is a velocity [m/s].
        columns: function of the unit axis, the direction `across` it and the pitch that returns the columns of [A; B],
            (6, m).
        pose: number of entries of q that are a unit quaternion wxyz: 4 for a spherical and a free joint, else 0.
        needs: the fields other than the axis that such a joint needs, "across" or "pitch".
    """

    turning: tuple[bool, ...]
    columns: Callable[[Array, Array, float], list[Array]]
    pose: int = 0
    needs: str = ""

    @property
    def position_count(self) -> int:
        """Number n_q of entries of q."""
        return len(self.turning) + (1 if self.pose else 0)

    @property
    def freedoms(self) -> int:
        """Number n_v of entries of qd, m."""
        return len(self.turning)

    @property
    def floats(self) -> bool:
        """Whether the body is free: it has six freedoms, and no edge to its parent."""
        return len(self.turning) == 6

    def displacement(self, rate_map: Array, axis: Array, q: Array) -> tuple[Array, Array]:
        """Return (Q, d), rotation and translation of the body's frame in the joint's frame on the parent.

        Args:
            rate_map: (6, m) [A; B].
            axis: (3,) unit axis.
            q: (n_q,) positions.
        """
        if self.pose:
            return rotation.from_quaternion(q[:4]), q[4:] if self.floats else _NONE
        turn = sum((x for x, turns in zip(q, self.turning, strict=True) if turns), start=0.0)
        return turned(axis, turn), rate_map[3:] @ q


def turned(axis: Array, angle: Scalar) -> Array:
    """Return the rotation about a unit axis by an angle [rad], (3, 3)."""
    along = outer(axis, axis)
    return along + cos(angle) * (np.eye(3) - along) + sin(angle) * skew(axis)


def _turn(axis: Array) -> Array:
    return concatenate([axis, _NONE])


def _shift(axis: Array) -> Array:
    return concatenate([_NONE, axis])


JOINT_KINDS: dict[str, JointKind] = {
    "revolute": JointKind((True,), lambda a, e, h: [_turn(a)]),
    "prismatic": JointKind((False,), lambda a, e, h: [_shift(a)]),
    "screw": JointKind((True,), lambda a, e, h: [_turn(a) + h * _shift(a)], needs="pitch"),
    "cylindrical": JointKind((True, False), lambda a, e, h: [_turn(a), _shift(a)]),
    "planar": JointKind(
        (True, False, False), lambda a, e, h: [_turn(a), _shift(e), _shift(cross(a, e))], needs="across"
    ),
    "spherical": JointKind((True,) * 3, lambda a, e, h: list(np.eye(6)[:3]), 4),
    "free": JointKind((True,) * 3 + (False,) * 3, lambda a, e, h: list(np.eye(6)), 4),
}
