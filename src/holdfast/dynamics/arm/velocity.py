"""Twists of the links: V(k) = phi^T(k+1, k) V(k+1) + H^T(k) qd(k) (paper, Sec. 5)."""

from __future__ import annotations

from holdfast.dynamics.arm.forward_kinematics import Kinematics
from holdfast.dynamics.arm.joint_map import expand
from holdfast.model.arm import Arm
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import rotate, shift_twist, unrotate


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
