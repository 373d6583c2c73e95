"""Mass matrix, tip Jacobian and bias torques of one arm, by the library."""

from __future__ import annotations

import numpy as np

from holdfast import Arm
from holdfast.dynamics.arm.bias import bias_torque
from holdfast.dynamics.arm.forward_kinematics import jacobian
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.arm.motion import ArmInputs, arm_motion

DOWN = np.array([0.0, 0.0, -9.81])


def mass_jacobian_bias(arm: Arm, q: np.ndarray, qd: np.ndarray, gravity: np.ndarray = DOWN) -> tuple[np.ndarray, ...]:
    """Return M, J of the tip (world axes) and the torques that keep qd constant."""
    standing = np.r_[np.zeros(3), -np.array(gravity)]  # what standing still in gravity feels like
    motion = arm_motion(ArmInputs(arm, q, qd, np.zeros(len(q)), np.zeros(6), standing))
    return (
        mass_matrix(arm, motion.at)[0],
        jacobian(arm, motion.at),
        bias_torque(arm, motion.at, motion.bias.wrenches)[0],
    )
