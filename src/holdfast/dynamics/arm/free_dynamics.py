"""Forward dynamics of one arm for given torques and tip wrench, by four algorithms."""

from __future__ import annotations

import numpy as np

from holdfast.dynamics.arm.articulated import articulated_filter, smooth, whiten
from holdfast.dynamics.arm.bias import bias_torque
from holdfast.dynamics.arm.forward_kinematics import jacobian
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.arm.motion import ArmMotion, at_rest
from holdfast.dynamics.arm.newton_euler import newton_euler
from holdfast.spatial.linalg import back_substitution, cholesky, forward_substitution
from holdfast.spatial.scalar import Array, array
from holdfast.spatial.spatial_vector import shift_twist, unrotate


def composite(motion: ArmMotion, torque: Array, tip_wrench: Array) -> Array:
    """Return qdd from M qdd = T - C - J^T f with the composite-body mass matrix. O(N^3).

    Args:
        motion: the arm's motion.
        torque: (N,) T.
        tip_wrench: (6,) f of the arm on the object about the tip point, world axes.
    """
    arm, at = motion.arm, motion.at
    C, _ = bias_torque(arm, at, motion.bias.wrenches)
    M = mass_matrix(arm, at)[0]
    L = cholesky(M)
    free = torque - C - tip_wrench @ jacobian(arm, at)
    return back_substitution(L, forward_substitution(L, free))


def newton_euler_columns(motion: ArmMotion, torque: Array, tip_wrench: Array) -> Array:
    """Return qdd by repeated Newton-Euler passes (Walker and Orin; paper, after (4.9)). O(N^3).

    One pass with qdd = 0 gives C + J^T f, and one pass for each unit acceleration gives a column of M.
    """
    N = motion.arm.joint_count
    none = np.zeros(6)
    loaded, _ = newton_euler(motion, np.zeros(N), tip_wrench)
    resting = at_rest(motion)
    M = array([newton_euler(resting, unit, none)[0] for unit in np.eye(N)])
    L = cholesky(0.5 * (M + M.T))
    return back_substitution(L, forward_substitution(L, torque - loaded))


def articulated(motion: ArmMotion, torque: Array, tip_wrench: Array) -> Array:
    """Return qdd in four sweeps: remove the bias (5.8a), then whiten and smooth (5.9). O(N)."""
    arm, at = motion.arm, motion.at
    C, _ = bias_torque(arm, at, motion.bias.wrenches)
    filter = articulated_filter(arm, at)
    eps, _ = whiten(arm, at, filter, torque - C, None, unrotate(at.end, tip_wrench))
    return smooth(arm, at, filter, eps / filter.D)[0]


def three_sweep(motion: ArmMotion, torque: Array, tip_wrench: Array) -> Array:
    """Return qdd in three sweeps: the bias is whitened along with the torques (5.14). O(N)."""
    arm, at = motion.arm, motion.at
    filter = articulated_filter(arm, at)
    eps, _ = whiten(arm, at, filter, torque, motion.bias.wrenches, unrotate(at.end, tip_wrench))
    return smooth(arm, at, filter, eps / filter.D)[0]


def tip_acceleration(motion: ArmMotion, qdd: Array, base: Array | None = None) -> Array:
    """Return alpha(0) = J qdd + Jdot qd of the tip point minus [0; g], world axes (2.1d).

    Args:
        motion: the arm's motion.
        qdd: (N,) joint accelerations.
        base: (6,) acceleration of the base in addition to that in `motion`, world axes; None for zero.
    """
    tip = jacobian(motion.arm, motion.at) @ qdd + motion.bias.tip_acceleration
    return tip if base is None else tip + shift_twist(motion.base_to_tip, base)
