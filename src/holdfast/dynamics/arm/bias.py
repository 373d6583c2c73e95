"""Bias accelerations, wrenches and torques of one arm, which are those without joint accelerations.

    zeta = phi^T a         accelerations at qdd = 0, including base motion and gravity
    p    = M zeta + b      wrenches for these accelerations
    C    = H phi p         bias torques                               (5.1c)
    Jdot qd = phi^T(1, 0) zeta(1) + a(0)                              (5.1d)

Gravity is treated as an acceleration -g of the base (docs/theory/arm.md), so it is included in zeta, C and Jdot qd, and
tip accelerations are the true ones minus [0; g].
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.forward_kinematics import Kinematics, expand, project
from holdfast.model.arm import Arm
from holdfast.spatial.scalar import Array, array, concatenate
from holdfast.spatial.spatial_vector import acceleration_gradient, rotate, shift_wrench, unrotate
from holdfast.spatial.vector import cross


class Bias(NamedTuple):
    """The bias quantities of one arm.

    Attributes:
        wrenches: per link, p(k) about O_k in link axes, minus external wrenches.
        tip_acceleration: (6,) Jdot qd of the tip point, world axes.
        of_base: (6,) wrench of an anchor's base that does not depend on the grasp force, about the base origin, base
            axes; None for none.
    """

    wrenches: tuple[Array, ...]
    tip_acceleration: Array
    of_base: Array | None = None


def bias_accelerations(
    arm: Arm,
    at: Kinematics,
    twists: tuple[Array, ...],
    qd: Array,
    base_twist: Array,
    base_acceleration: Array,
    qdd: Array | None = None,
) -> Iterator[tuple[Array, Array]]:
    """Yield zeta(k) = phi^T(k+1, k) zeta(k+1) + a(k) and its K = omega_dot~ + w~ w~, link axes, base to tip.

    If joint accelerations qdd (N,) are given, zeta are the total accelerations of the links.
    a(k) = [w' x h qd; w' x (w' x l) + 2 w' x s qd] for a motion subspace [h; s] and the parent's angular velocity w'
    (docs/theory/arm.md). With the parent's K, the linear part shifted to the link is v_dot + K l.
    """
    zeta, K = base_acceleration_and_gradient(arm, base_twist, base_acceleration)
    for k, (joint, E, l, V, rate) in enumerate(zip(arm.joints, at.E, at.l, twists, qd, strict=True)):
        carried = concatenate([zeta[:3], zeta[3:] + K @ l])
        h, s = joint.motion_subspace
        turning = np.zeros(3) if h is None else cross(V[:3], rate * h)  # w x h qd = w' x h qd
        sliding = np.zeros(3) if s is None else 2.0 * cross(V[:3], rate * s)
        zeta = unrotate(E, carried) + concatenate([turning, sliding])
        if qdd is not None:
            zeta = zeta + expand(joint, qdd[k])
        K = acceleration_gradient(zeta[:3], V[:3])
        yield zeta, K


def base_acceleration_and_gradient(arm: Arm, base_twist: Array, base_acceleration: Array) -> tuple[Array, Array]:
    """Return zeta and K of the base, in base axes; see `bias_accelerations`."""
    zeta = unrotate(arm.base.R, base_acceleration)
    return zeta, acceleration_gradient(zeta[:3], base_twist[:3] @ arm.base.R)


def bias(
    arm: Arm,
    at: Kinematics,
    twists: tuple[Array, ...],
    qd: Array,
    base_twist: Array,
    base_acceleration: Array,
    link_wrenches: Array | None = None,
) -> Bias:
    """Return the wrenches and the tip acceleration at qdd = 0. One outward sweep, O(N).

    Args:
        arm: the arm.
        at: its configuration.
        twists: its link twists.
        qd: (N,) joint rates.
        base_twist: (6,) twist of the base origin, world axes.
        base_acceleration: (6,) acceleration of the base origin minus [0; g], world axes.
        link_wrenches: (N, 6) external wrenches about the link origins, world axes.
    """
    found = list(bias_accelerations(arm, at, twists, qd, base_twist, base_acceleration))
    wrenches = [
        link.spatial_inertia.wrench(zeta, V[:3], K) for link, V, (zeta, K) in zip(arm.links, twists, found, strict=True)
    ]
    if link_wrenches is not None:
        wrenches = [p - unrotate(R, f) for p, R, f in zip(wrenches, at.R, link_wrenches, strict=True)]
    return Bias(tuple(wrenches), acceleration_at_tip(arm, at, found, base_twist, base_acceleration))


def acceleration_at_tip(
    arm: Arm, at: Kinematics, found: list[tuple[Array, Array]], base_twist: Array, base_acceleration: Array
) -> Array:
    """Return the acceleration (6,) of the tip point, world axes, from the output of `bias_accelerations`.

    The tip of an anchor moves with its base.
    """
    zeta, K = found[-1] if found else base_acceleration_and_gradient(arm, base_twist, base_acceleration)
    return rotate(at.end, concatenate([zeta[:3], zeta[3:] + K @ arm.tip.p]))


def bias_torque(arm: Arm, at: Kinematics, wrenches: tuple[Array, ...]) -> tuple[Array, Array]:
    """Return C = H phi p and the wrench at the base. One inward sweep, O(N).

    Returns:
        (N,) bias torques, and (6,) wrench of the base on the first link at qdd = 0, about that
        link's origin, in its axes; zero without links.
    """
    if not wrenches:
        return np.zeros(0), np.zeros(6)
    F, torques = wrenches[-1], [project(arm.joints[-1], wrenches[-1])]
    for k in reversed(range(arm.joint_count - 1)):
        F = wrenches[k] + shift_wrench(at.l[k + 1], rotate(at.E[k + 1], F))
        torques.insert(0, project(arm.joints[k], F))
    return array(torques), F
