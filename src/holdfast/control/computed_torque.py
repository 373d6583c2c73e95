"""Torques that give the object an acceleration while the grasps bear given wrenches."""

from __future__ import annotations

import numpy as np

from holdfast.dynamics.arm.jacobian import jacobian
from holdfast.dynamics.arm.newton_euler import drive_torques
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion, pseudo_gravity
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.linalg import least_solution
from holdfast.spatial.scalar import Array, concatenate
from holdfast.spatial.spatial_vector import shift_twist
from holdfast.state import Inputs, State


def computed_torque(
    chain: ClosedChain, state: State, acceleration: Array, wrenches: Array, joint_damping: float = 0.0
) -> Array:
    """Return the torques of the least qdd that goes with the object's acceleration, (n,); see `drive_torques`.

    Arms that cannot follow do so as nearly as they can. Bases are taken to stand still.

    Args:
        chain: the chain.
        state: positions and velocities.
        acceleration: (6,) [omega_dot; v_dot] of C, true, world axes.
        wrenches: (arms, 6) f of each arm on the object about its contact, world axes.
        joint_damping: of the joint motion that no grasp feels [1/s].
    """
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), Inputs().shaped(chain))
    qdd = joint_accelerations(motion, state.qd, acceleration - pseudo_gravity(chain), joint_damping)
    return concatenate(
        drive_torques(arm, qdd[part], f)
        for arm, part, f in zip(motion.arms.values(), chain.arm_joints, wrenches, strict=True)
    )


def joint_accelerations(motion: ChainMotion, qd: Array, acceleration: Array, joint_damping: float = 0.0) -> Array:
    """Return the least joint accelerations that go with the object's, (n,).

    K (J qdd + Jdot qd) = K (A alpha(C) + a(C) - g), arm by arm; what moves no tip is
    damped. Arms that cannot follow do so as nearly as they can.

    Args:
        motion: the chain in motion.
        qd: (n,) joint rates.
        acceleration: (6,) alpha(C), less [0; g], world axes.
        joint_damping: of the joint motion that no grasp feels [1/s].
    """
    chain, contacts = motion.chain, dict(zip(motion.chain.grasps, motion.contacts, strict=True))
    qdd = []
    for name, arm in motion.arms.items():
        damped = -joint_damping * qd[chain.joints[name]]
        if name in contacts:
            c = contacts[name]
            tip = shift_twist(c.offset, acceleration) + c.a - c.g - arm.bias.tip_acceleration
            rows = c.K @ jacobian(arm.arm, arm.at)
            damped = damped + least_solution(rows, c.K @ tip - rows @ damped)
        qdd.append(damped)
    return concatenate(qdd)
