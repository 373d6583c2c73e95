"""Hinge, soft-finger and ball contacts by the paper's own solution (b.9)."""

from __future__ import annotations

import numpy as np

from holdfast.dynamics.arm.articulated import articulated_filter, smooth, whiten
from holdfast.dynamics.arm.bias import bias_torque
from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution
from holdfast.dynamics.closed.omega import omega_recursive
from holdfast.dynamics.closed.stacked import Stacked
from holdfast.spatial.linalg import ldl, ldl_solve
from holdfast.spatial.scalar import concatenate
from holdfast.spatial.spatial_vector import rotate, unrotate


def nonrigid(motion: ChainMotion) -> Solution:
    """Return the solution for any grasps where Omega is regular, O(n) + O(l^3).

    y + G_1 = J M^-1 T' + A M(C)^-1 b(C) + Jdot qd + Hdot^T W - a(C)         (b.9a)
    Pi      = Omega^-1 - Omega^-1 H^T [H Omega^-1 H^T]^-1 H Omega^-1         (b.9c)
    f       = Pi (y + G_1)                                                   (b.9d)
    W_dot   = -[H Omega^-1 H^T]^-1 H Omega^-1 (y + G_1)                      (b.9f)
    qdd     = M^-1 (T' - J^T f)                                              (b.9e)

    The bias torques C are taken off first, so J M^-1 T + G_1 is y + G_1 with T' in y.

    Raises:
        MethodNotApplicable: if Omega is singular or has lost its digits.
    """
    s = Stacked(motion)
    arms = motion.holding
    filters = [articulated_filter(arm.arm, arm.at) for arm in arms]
    T_free = [arm.torque - bias_torque(arm.arm, arm.at, arm.bias.wrenches)[0] for arm in arms]

    tips = []
    for arm, filter, T in zip(arms, filters, T_free, strict=True):
        eps, _ = whiten(arm.arm, arm.at, filter, T, None, None)
        tips.append(rotate(arm.at.R[-1], smooth(arm.arm, arm.at, filter, eps / filter.D)[1]))

    omega = omega_recursive(motion, s, filters)
    rhs = omega.solve(concatenate(tips) - s.a_prime + s.g)
    columns = omega.solve(s.HT)  # Omega^-1 H^T
    free = s.HT.T @ columns
    W_dot = -ldl_solve(ldl(free, np.diag(free)), s.HT.T @ rhs) if s.HT.shape[1] else np.zeros(0)
    f = rhs + columns @ W_dot  # (b.6b)

    qdd = []
    for i, (arm, filter, T) in enumerate(zip(arms, filters, T_free, strict=True)):
        eps, _ = whiten(arm.arm, arm.at, filter, T, None, unrotate(arm.at.R[-1], f[6 * i : 6 * i + 6]))
        qdd.append(smooth(arm.arm, arm.at, filter, eps / filter.D)[0])
    return s.solution(concatenate(qdd), f, W_dot)
