"""Mass matrix, tip Jacobian and bias torques of one arm, by the library."""

from __future__ import annotations

import numpy as np

from holdfast import Arm
from holdfast.dynamics.arm.bias import bias_torque
from holdfast.dynamics.arm.jacobian import jacobian
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.arm.motion import ArmInputs, arm_motion
from holdfast.dynamics.arm.posture import posture

UP = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 9.81])  # what standing still in gravity feels like


def mass_jacobian_bias(arm: Arm, q: np.ndarray, qd: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return M, J of the tip (world axes) and the torques that keep qd constant."""
    at = posture(arm, q)
    motion = arm_motion(ArmInputs(arm, q, qd, np.zeros(len(q)), np.zeros(6), UP))
    return mass_matrix(arm, at)[0], jacobian(arm, at), bias_torque(arm, at, motion.bias.wrenches)[0]
