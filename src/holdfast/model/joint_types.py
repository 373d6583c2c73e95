"""The types of joints, as one table; no other code depends on their names.

A joint with one degree of freedom is a screw about its axis a: its motion subspace is H^T = [t a; s a] in the axes of
the link that it moves, where t = 1 if the link rotates with q, and s is its translation along the axis per unit of q. A
joint with several degrees of freedom is a chain of these with massless links. The successive scalar divisions by D in
the filter are then equivalent to the factorisation of the matrix D of such a joint.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from holdfast.spatial.scalar import Array


@dataclass(frozen=True)
class JointType:
    """The properties of one type of joint.

    Attributes:
        turns: whether the link rotates with q, which is then an angle [rad]; otherwise q is a length [m].
        travel: translation of the link along the axis per unit of q [m/rad or 1].
        parts: for several degrees of freedom, the names of the types with one degree that replace this one, in order
            from the parent to the link, each with a function from the joint's axis to its own axis, both in link axes.
        urdf: the joint types in URDF files that are read as this one.
        mjcf: type of the MJCF joint; None if there is none.
    """

    turns: bool = True
    travel: float = 0.0
    parts: tuple[tuple[str, Callable[[Array], Array]], ...] = ()
    urdf: tuple[str, ...] = ()
    mjcf: str | None = None


JOINT_TYPES: dict[str, JointType] = {
    "revolute": JointType(urdf=("revolute", "continuous"), mjcf="hinge"),
    "prismatic": JointType(turns=False, travel=1.0, urdf=("prismatic",), mjcf="slide"),
}
