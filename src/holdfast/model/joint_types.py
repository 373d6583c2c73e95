"""The types of joints, as one table; no other code depends on their names.

A joint with one degree of freedom is a screw about its axis a: its motion subspace is H^T = [t a; s a] in the axes of
the link that it moves, where t = 1 if the link rotates with q, and s is its translation along the axis per unit of q. A
joint with several degrees of freedom is a chain of these with massless links. The successive scalar divisions by D in
the filter are then equivalent to the factorisation of the matrix D of such a joint.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from holdfast.spatial.scalar import Array
from holdfast.spatial.vector import cross


@dataclass(frozen=True)
class JointType:
    """The properties of one type of joint.

    Attributes:
        turns: whether the link rotates with q, which is then an angle [rad]; otherwise q is a length [m].
        travel: translation of the link along the axis per unit of q [m/rad or 1].
        threaded: whether the translation per unit of q is the joint's own `pitch`.
        parts: for several degrees of freedom, the names of the types with one degree that replace this one, in order
            from the parent to the link, each with a function from the joint's axis to its own axis, both in link axes.
        quaternion: whether the joint has three degrees of freedom and its position is a unit quaternion; only chains
            that are answered as forests may have it.
        urdf: the joint types in URDF files that are read as this one.
        mjcf: type of the MJCF joint; None if there is none.
    """

    turns: bool = True
    travel: float = 0.0
    threaded: bool = False
    parts: tuple[tuple[str, Callable[[Array], Array]], ...] = ()
    urdf: tuple[str, ...] = ()
    mjcf: str | None = None
    quaternion: bool = False

    @property
    def position_count(self) -> int:
        """Number of entries of q of a joint that has no parts."""
        return 4 if self.quaternion else 1

    @property
    def freedoms(self) -> int:
        """Number of entries of qd of a joint that has no parts."""
        return 3 if self.quaternion else 1


def first_across(normal: Array) -> Array:
    """Return the direction across a unit normal that is nearest to x for a normal along z, and so on in turn, (3,)."""
    along = np.eye(3)[(int(np.argmax(np.abs(normal))) + 1) % 3]
    first = along - (normal @ along) * normal
    return first / np.linalg.norm(first)


def second_across(normal: Array) -> Array:
    """Return the direction across the normal and the first one, (3,)."""
    return cross(normal, first_across(normal))


JOINT_TYPES: dict[str, JointType] = {
    "revolute": JointType(urdf=("revolute", "continuous"), mjcf="hinge"),
    "prismatic": JointType(turns=False, travel=1.0, urdf=("prismatic",), mjcf="slide"),
    "screw": JointType(threaded=True),
    "cylindrical": JointType(parts=(("revolute", np.array), ("prismatic", np.array))),
    "planar": JointType(parts=(("prismatic", first_across), ("prismatic", second_across), ("revolute", np.array))),
    "spherical": JointType(mjcf="ball", quaternion=True),
}
