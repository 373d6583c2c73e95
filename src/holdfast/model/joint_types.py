"""The types of joints: one row each, and nothing else in the library compares their names.

A joint of one degree of freedom is a screw about its axis a: its motion subspace is H^T = [t a; s a] in the axes of
the link it moves, t = 1 where the link turns with q, s its travel along the axis per unit of q. A joint of several
degrees is a chain of those, the links between them without mass: the filter's scalar divisions by D, one after the
other, are the factorisation of the block that such a joint would have.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from holdfast.spatial.scalar import Array


@dataclass(frozen=True)
class JointType:
    """What distinguishes one type of joint from another.

    Attributes:
        turns: whether the link turns with q, which is an angle then [rad]; else q is a length [m].
        travel: how far the link shifts along the axis per unit of q [m/rad or 1].
        parts: for several degrees of freedom: names of the types of one degree that follow each other from the parent
            to the link, each with a function from the joint's axis to its own axis, both in link axes.
        urdf: the types of a URDF file that are read as this one.
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
