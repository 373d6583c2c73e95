"""Inverse dynamics of one arm by the Newton-Euler recursion: an outward and an inward sweep."""

from __future__ import annotations

import numpy as np

from holdfast.dynamics.arm.forward_kinematics import expand, project
from holdfast.dynamics.arm.motion import ArmMotion
from holdfast.spatial.scalar import Array, array
from holdfast.spatial.spatial_vector import rotate, shift_twist, shift_wrench, unrotate


def drive_torques(motion: ArmMotion, qdd: Array, tip_wrench: Array, base: Array | None = None) -> tuple[Array, Array]:
    """Return drive torques tau = M qdd + C + J^T f + damping qd + stiffness (q - rest), (N,), and the base wrench.

    O(N); see `newton_euler`.
    """
    T, wrench = newton_euler(motion, qdd, tip_wrench, base)
    return T + motion.passive_torque, wrench


def newton_euler(motion: ArmMotion, qdd: Array, tip_wrench: Array, base: Array | None = None) -> tuple[Array, Array]:
    """Return the torques T for given accelerations and tip wrench, and the base wrench.

    T = M qdd + C + J^T f (2.1a) is computed link by link: F(k) = phi F(k-1) + M(k) alpha(k) + b(k).
    T does not include dampers and springs, which `drive_torques` adds. O(N).

    Args:
        motion: the arm's motion (its bias wrenches are M zeta + b).
        qdd: (N,) joint accelerations.
        tip_wrench: (6,) f of the arm on the object about the tip point, world axes.
        base: (6,) acceleration of the base in addition to that in `motion`, world axes; None for zero.

    Returns:
        (N,) torques, and (6,) wrench of the base on the arm about the base origin, world axes.
    """
    arm, at = motion.arm, motion.at
    alpha = np.zeros(6) if base is None else unrotate(arm.base.R, base)
    forces = []
    for joint, link, E, l, rate, p in zip(arm.joints, arm.links, at.E, at.l, qdd, motion.bias.wrenches, strict=True):
        alpha = unrotate(E, shift_twist(l, alpha)) + expand(joint, rate)
        forces.append(link.spatial_inertia.apply(alpha) + p)

    F = shift_wrench(arm.tip.p, unrotate(at.end, tip_wrench))
    torques = []
    for joint, E, l, force in reversed(list(zip(arm.joints, at.E, at.l, forces, strict=True))):
        F = F + force
        torques.insert(0, project(joint, F))
        F = shift_wrench(l, rotate(E, F))
    if motion.bias.of_base is not None:
        F = F + motion.bias.of_base
    # the armature rotates with the joint and loads its own drive only
    return array(torques) + arm.armature * qdd, rotate(arm.base.R, F)
