"""Where the links of an arm are."""

from __future__ import annotations

from typing import NamedTuple

from holdfast.model.arm import Arm
from holdfast.model.joint import Joint
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, cos, sin


class Posture(NamedTuple):
    """Geometry of an arm at joint positions q.

    Attributes:
        E: per link, (3, 3) from link axes to its parent's axes.
        l: per link, (3,) from the parent's origin to O_k, parent axes [m].
        R: per link, (3, 3) from link axes to world axes.
        reach: per link, (3,) from O_k to the tip point, world axes [m].
        tip: pose of the tip frame in the world.
    """

    E: tuple[Array, ...]
    l: tuple[Array, ...]
    R: tuple[Array, ...]
    reach: tuple[Array, ...]
    tip: Pose


def joint_placement(joint: Joint, q: Scalar) -> tuple[Array, Array]:
    """Return (E, l): rotation from link axes to parent axes, and O_k from the parent's origin."""
    h, s = joint.motion_subspace
    E, l = joint.placement.R, joint.placement.p
    if h is not None:
        fixed, cosine, sine = joint.rotation_parts
        E = fixed + cos(q) * cosine + sin(q) * sine
    return E, l if s is None else l + q * joint.parent_shift


def posture(arm: Arm, q: Array) -> Posture:
    """Return the posture of an arm at joint positions q, base to tip [rad or m].

    Positions are measured back from the tip, so that a far-off base costs no digits.
    Cost O(N).
    """
    E, l, R = [], [], []
    R_parent = arm.base.R
    for joint, qk in zip(arm.joints, q, strict=True):
        Ek, lk = joint_placement(joint, qk)
        R_parent = R_parent @ Ek
        E.append(Ek)
        l.append(lk)
        R.append(R_parent)

    r = R[-1] @ arm.tip.p
    reach = [r]
    for k in range(arm.joint_count - 1, 0, -1):
        r = R[k - 1] @ l[k] + r
        reach.insert(0, r)
    tip = Pose.unchecked(R[-1] @ arm.tip.R, arm.base.p + (arm.base.R @ l[0] + reach[0]))
    return Posture(tuple(E), tuple(l), tuple(R), tuple(reach), tip)
