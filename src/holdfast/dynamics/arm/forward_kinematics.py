"""Forward kinematics of one arm."""

from __future__ import annotations

from typing import NamedTuple

from holdfast.model.arm import Arm
from holdfast.model.joint import Joint
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, cos, sin


class Kinematics(NamedTuple):
    """Geometry of an arm at joint positions q.

    Attributes:
        E: per link, (3, 3) from link axes to its parent's axes.
        l: per link, (3,) from the parent's origin to O_k, parent axes [m].
        R: per link, (3, 3) from link axes to world axes.
        reach: per link, (3,) from O_k to the tip point, world axes [m].
        tip: pose of the tip frame in the world.
        end: (3, 3) from the axes of the last link, or of the base of an anchor, to world axes.
        from_base: (3,) from the base origin to the tip point, world axes [m].
    """

    E: tuple[Array, ...]
    l: tuple[Array, ...]
    R: tuple[Array, ...]
    reach: tuple[Array, ...]
    tip: Pose
    end: Array
    from_base: Array


def joint_placement(joint: Joint, q: Scalar) -> tuple[Array, Array]:
    """Return (E, l): rotation from link axes to parent axes, and O_k from the parent's origin."""
    return joint_rotation(joint, q), joint_translation(joint, q)


def joint_rotation(joint: Joint, q: Scalar) -> Array:
    """Return E, (3, 3) from link axes to parent axes."""
    if joint.motion_subspace[0] is None:
        return joint.placement.R
    fixed, cosine, sine = joint.rotation_parts
    return fixed + cos(q) * cosine + sin(q) * sine


def joint_translation(joint: Joint, q: Scalar) -> Array:
    """Return l, (3,) from the parent's origin to O_k, parent axes [m]."""
    l = joint.placement.p
    return l if joint.motion_subspace[1] is None else l + q * joint.parent_shift


def forward_kinematics(arm: Arm, q: Array) -> Kinematics:
    """Return the configuration of an arm at joint positions q, base to tip [rad or m].

    Positions are measured from the tip backwards, so that the distance of the base costs no digits. O(N).
    """
    E, l, axes = [], [], [arm.base.R]
    for joint, qk in zip(arm.joints, q, strict=True):
        Ek, lk = joint_placement(joint, qk)
        E.append(Ek)
        l.append(lk)
        axes.append(axes[-1] @ Ek)

    r, reach = axes[-1] @ arm.tip.p, []
    for lk, before in reversed(list(zip(l, axes[:-1], strict=True))):
        reach.insert(0, r)
        r = before @ lk + r
    tip = Pose.unchecked(axes[-1] @ arm.tip.R, arm.base.p + r)
    return Kinematics(tuple(E), tuple(l), tuple(axes[1:]), tuple(reach), tip, axes[-1], r)
