"""Inverse dynamics of arms on a trunk: Newton-Euler recursions for the arms, then for the trunk with their wrenches."""

from __future__ import annotations

from functools import reduce
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.motion import ArmMotion
from holdfast.dynamics.arm.newton_euler import newton_euler
from holdfast.dynamics.closed.chain_motion import ChainMotion
from holdfast.dynamics.trunk.trunk_motion import TrunkAcceleration
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.spatial.scalar import Array, Scalar, concatenate, each, maximum
from holdfast.spatial.spatial_vector import shift_wrench

NO_BASE_WRENCH = 1e-8  # a wrench on the floating base below this, relative to the largest one, is rounding


class TrunkTorques(NamedTuple):
    """The torques and the base wrench for given accelerations.

    Attributes:
        tau: (n,) torques of the drives of trunk and arms.
        base: (6,) wrench on the first body, about the base origin, which must be zero for a floating base.
        largest: the largest entry of any wrench on a body of the trunk.
    """

    tau: Array
    base: Array
    largest: Scalar


def trunk_torques(motion: ChainMotion, qdd: Array, f: Array, base: Array | None = None) -> TrunkTorques:
    """Return the drives' torques of trunk and arms, and the wrench on the base. O(n).

    Args:
        motion: the chain's motion with zero drive torques.
        qdd: (n,) joint accelerations.
        f: (arms, 6) wrench of each arm on the object, about the contact, world axes.
        base: (6,) true acceleration of a floating base; None without one.
    """
    chain, trunk = motion.chain, motion.trunk
    accelerations = qdd[trunk.joints]
    betas = trunk.accelerations(TrunkAcceleration(accelerations, base))
    found = each(
        drive_torques_and_base,
        motion.arms.values(),
        [qdd[part] for part in chain.arm_joints],
        f,
        [trunk.under(name, betas) for name in motion.arms],
    )
    of_arms = [torques for torques, _ in found]
    base_wrenches = {name: wrench for name, (_, wrench) in zip(motion.arms, found, strict=True)}
    torques, total, largest = [], np.zeros(6), np.zeros(())[()]
    for k in reversed(range(len(trunk.bodies))):
        body = trunk.bodies[k]
        loads = [body.wrench + body.inertia.apply(betas[k])]
        loads += [shift_wrench(m.offset, base_wrenches[name]) for name, m in trunk.mounts.items() if m.body == k]
        total = sum(loads, start=total)
        largest = reduce(maximum, (abs(entry) for load in (total, *loads) for entry in load), largest)
        if body.H is not None and body.joint is not None:
            rotor = body.joint.armature * accelerations[k - trunk.floats]
            torques.insert(0, body.H @ total + rotor - body.torque)  # body.torque is minus the passive torque
        total = shift_wrench(body.reach, total)
    return TrunkTorques(concatenate([torques, *of_arms]), total, largest)


def drive_torques_and_base(arm: ArmMotion, qdd: Array, f: Array, base: Array | None) -> tuple[Array, Array]:
    """Return an arm's drive torques, (N,), and the wrench of its base on it, (6,); arguments as in `newton_euler`."""
    T, wrench = newton_euler(arm, qdd, f, base)
    return T + arm.passive_torque, wrench


def needs_drive(base: Array, largest: Array) -> Array:
    """Return whether wrenches on a base, (..., 6), exceed rounding; the largest wrenches on the trunk are (...)."""
    return ~(np.abs(base).max(-1) <= NO_BASE_WRENCH * largest)


def require_no_base_wrench(base: Array, largest: Array) -> None:
    """Refuse accelerations of a floating base for which it would need a drive; arguments as in `needs_drive`.

    Raises:
        StateError: a wrench on the base is needed; the message gives it.
    """
    if needs_drive(base, largest):
        raise StateError(
            f"base_acceleration: the floating base has no drive, but would need the wrench {checks.place(base)}"
            " (moment, force about its origin) to accelerate so; try the accelerations and wrenches of forward_dynamics"
        )
