"""Kinematics of one arm: joint maps, poses and twists of its links, and the tip Jacobian.

The joint map H(k) with H^T = [h; s] is the motion subspace of a joint with one degree of freedom. Its angular part h or
linear part s is None where it is zero: revolute [h; 0], prismatic [0; s], screw [h; s]. With it,
    V(k) = phi^T(k+1, k) V(k+1) + H^T(k) qd(k)                        (paper, Sec. 5)
    V(0) = J qd,  J = B^T phi^T H^T                                  (5.1b)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.model.arm import Arm
from holdfast.model.joint import Joint
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, cos, sin
from holdfast.spatial.spatial_vector import rotate, shift_twist, unrotate
from holdfast.spatial.symmetric import Symmetric6
from holdfast.spatial.vector import cross


def project(joint: Joint, f: Array) -> Scalar:
    """Return H f, the component along the joint of a wrench in link axes [N m or N]."""
    h, s = joint.motion_subspace
    if h is None:
        return s @ f[3:]
    return h @ f[:3] if s is None else h @ f[:3] + s @ f[3:]


def expand(joint: Joint, rate: Scalar) -> Array:
    """Return H^T rate, the twist (or acceleration) in link axes due to a joint rate."""
    return concatenate([np.zeros(3) if part is None else rate * part for part in joint.motion_subspace])


def column(joint: Joint, P: Symmetric6) -> Array:
    """Return P H^T, a 6-vector."""
    h, s = joint.motion_subspace
    if h is None:
        return concatenate([P.al @ s, P.ll @ s])
    turning = concatenate([P.aa @ h, h @ P.al])
    return turning if s is None else turning + concatenate([P.al @ s, P.ll @ s])


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


def link_twists(arm: Arm, at: Kinematics, qd: Array, base_twist: Array) -> tuple[Array, ...]:
    """Return the twist of every link about its origin, link axes, base to tip.

    Args:
        arm: the arm.
        at: its configuration.
        qd: (N,) joint rates [rad/s or m/s].
        base_twist: (6,) twist of the base origin, world axes.
    """
    V = unrotate(arm.base.R, base_twist)
    twists = []
    for joint, E, l, rate in zip(arm.joints, at.E, at.l, qd, strict=True):
        V = unrotate(E, shift_twist(l, V)) + expand(joint, rate)
        twists.append(V)
    return tuple(twists)


def tip_twist(arm: Arm, at: Kinematics, twists: tuple[Array, ...], base_twist: Array) -> Array:
    """Return V(0) = phi^T(1, 0) V(1), the twist of the tip point, world axes, (6,). For anchors, V(1) is the base's."""
    last = twists[-1] if twists else unrotate(arm.base.R, base_twist)
    return rotate(at.end, shift_twist(arm.tip.p, last))


def jacobian(arm: Arm, at: Kinematics) -> Array:
    """Return the Jacobian of the tip point, (6, N), world axes. O(N)."""
    columns = []
    for joint, R, reach in zip(arm.joints, at.R, at.reach, strict=True):
        h, s = joint.motion_subspace
        along = None if s is None else R @ s
        if h is None:
            columns.append(concatenate([np.zeros(3), along]))
        else:
            axis = R @ h
            columns.append(concatenate([axis, cross(axis, reach) if along is None else cross(axis, reach) + along]))
    return array(columns).reshape(-1, 6).T
