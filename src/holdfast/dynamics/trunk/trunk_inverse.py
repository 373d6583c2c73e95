"""Inverse dynamics of arms on a trunk: the arms by Newton and Euler, then the trunk under their base wrenches."""

from __future__ import annotations

import numpy as np

from holdfast.dynamics.arm.newton_euler import newton_euler
from holdfast.dynamics.closed.chain_motion import ChainMotion
from holdfast.dynamics.trunk.trunk_motion import TrunkAcceleration
from holdfast.errors import StateError
from holdfast.model.closed_chain import TRUNK
from holdfast.spatial.scalar import Array, concatenate
from holdfast.spatial.spatial_vector import shift_wrench

UNDRIVEN = 1e-8  # of the largest wrench on the floating base: what is left is rounding


def trunk_inverse_dynamics(motion: ChainMotion, qdd: Array, f: Array, base: Array | None) -> Array:
    """Return the drives' torques of trunk and arms, (n,). O(n).

    Args:
        motion: the chain in motion, with a trunk, its drives' torques zero.
        qdd: (n,) joint accelerations.
        f: (arms, 6) of each arm on the object, about the contact, world axes.
        base: (6,) true acceleration of a floating base.

    Raises:
        StateError: a floating base, which no drive moves, would need a wrench to accelerate so.
    """
    chain, trunk = motion.chain, motion.trunk
    assert trunk is not None
    betas = trunk.accelerations(TrunkAcceleration(qdd[chain.joints[TRUNK]], base))
    of_arms, base_wrenches = [], {}
    for (name, arm), wrench in zip(motion.arms.items(), f, strict=True):
        part = chain.joints[name]
        T, base_wrenches[name] = newton_euler(arm, qdd[part], wrench, trunk.under(name, betas))
        of_arms.append(T + arm.passive)

    accelerations = qdd[chain.joints[TRUNK]]
    torques, total, largest = [], np.zeros(6), 0.0
    for k in reversed(range(len(trunk.bodies))):
        body = trunk.bodies[k]
        loads = [body.wrench + body.inertia.apply(betas[k])]
        loads += [shift_wrench(m.offset, base_wrenches[name]) for name, m in trunk.mounts.items() if m.body == k]
        total = sum(loads, start=total)
        largest = max(largest, *(float(np.abs(load).max()) for load in (total, *loads)))
        if body.H is not None and body.joint is not None:
            rotor = body.joint.armature * accelerations[k - trunk.floats]
            torques.insert(0, body.H @ total + rotor - body.torque)  # which is the passive torque's, reversed
        total = shift_wrench(body.reach, total)
    if trunk.floats and not float(np.abs(total).max()) <= UNDRIVEN * largest:
        raise StateError(
            f"base_acceleration: the floating base has no drive, but would need the wrench {total} (moment, force about"
            " its origin) to accelerate so; try the accelerations and wrenches of forward_dynamics"
        )
    return concatenate([torques, *of_arms])
