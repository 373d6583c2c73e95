"""Computed torque: the object follows a path while the arms squeeze it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.control.grasp_forces import commanded_wrenches
from holdfast.control.paths import Target
from holdfast.dynamics.arm.jacobian import jacobian
from holdfast.dynamics.arm.newton_euler import drive_torques
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion, pseudo_gravity
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import shift_twist
from holdfast.state import Inputs, State

NULL_SINGULAR_VALUE = 1e-8  # of the largest: tip directions an arm cannot move along


@dataclass(frozen=True, eq=False)
class ObjectTracking:
    """tau = M qdd + C + J^T f + damping, with qdd and f that give the object its acceleration.

    The commanded acceleration is the path's and a correction,
    alpha = alpha_d + damping (V_d - V) + stiffness [log(R_d R^T); p_d - p]; the error then
    obeys e'' + damping e' + stiffness e = 0. Bases are taken to stand still.

    Attributes:
        chain: the chain as the controller knows it.
        path: t [s] -> where the object should be.
        squeeze: internal force of every arm along its contact normal, into the object [N].
        stiffness: of the pose error [1/s^2].
        damping: of the twist error [1/s]; 2 sqrt(stiffness) is critical.
        joint_damping: of joint motions that do not move the object [1/s].
    """

    chain: ClosedChain
    path: Callable[[float], Target]
    squeeze: float = 0.0
    stiffness: float = 100.0
    damping: float = 20.0
    joint_damping: float = 10.0

    def __call__(self, t: float, state: State, memory: Any) -> tuple[Array, Any]:
        """Return the torques (n,) [N m or N]; the memory is not used."""
        chain = self.chain
        acceleration = self.commanded_acceleration(t, state)
        motion = chain_motion(chain, state, np.zeros(chain.joint_count), Inputs().shaped(chain))
        qdd = joint_accelerations(motion, state.qd, acceleration - pseudo_gravity(chain), self.joint_damping)
        wrenches = commanded_wrenches(chain, state, acceleration, self.squeeze)
        tau = np.zeros(chain.joint_count)
        for i, (name, arm) in enumerate(motion.arms.items()):
            part = chain.joints[name]
            tau[part] = drive_torques(arm, state.qd[part], qdd[part], wrenches[i])
        return tau, memory

    def commanded_acceleration(self, t: float, state: State) -> Array:
        """Return [omega_dot; v_dot] of C that the object is to have, (6,) world axes."""
        target = self.path(t)
        frame = state.object_frame
        error = np.concatenate([rotation.log(target.pose.R @ frame.R.T), target.pose.p - frame.p])
        return target.acceleration + self.damping * (target.twist - state.object_twist) + self.stiffness * error


def joint_accelerations(motion: ChainMotion, qd: Array, acceleration: Array, joint_damping: float) -> Array:
    """Return the least joint accelerations that go with the object's, (n,).

    K (J qdd + Jdot qd) = K (A alpha(C) + a(C) - g), arm by arm; what moves no tip is
    damped. Arms that cannot follow do so as nearly as they can.

    Args:
        motion: the chain in motion.
        qd: (n,) joint rates.
        acceleration: (6,) alpha(C), less [0; g], world axes.
        joint_damping: of the joint motion that no grasp feels [1/s].
    """
    chain = motion.chain
    qdd = -joint_damping * qd
    for name, c in zip(chain.grasps, motion.contacts, strict=True):
        arm, part = motion.arms[name], chain.joints[name]
        K = c.K
        tip = shift_twist(c.offset, acceleration) + c.a - c.g - arm.bias.tip_acceleration
        rows = K @ jacobian(arm.arm, arm.at)
        inverse = np.linalg.pinv(rows, rcond=NULL_SINGULAR_VALUE)
        qdd[part] += inverse @ (K @ tip - rows @ qdd[part])
    return qdd
