"""The solution for hinge, soft-finger and ball contacts by the method of the paper (b.9)."""

from __future__ import annotations

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution
from holdfast.dynamics.closed.omega import filtered_arms, omega_recursive, per_arm
from holdfast.dynamics.closed.stacked import Stacked
from holdfast.spatial.linalg import ldl, ldl_solve
from holdfast.spatial.scalar import concatenate


def nonrigid(motion: ChainMotion) -> Solution:
    """Return the solution for any grasps if Omega is regular, O(n) + O(l^3).

    y + G_1 = J M^-1 T' + A M(C)^-1 b(C) + Jdot qd + Hdot^T W - a(C)         (b.9a)
    Pi      = Omega^-1 - Omega^-1 H^T [H Omega^-1 H^T]^-1 H Omega^-1         (b.9c)
    f       = Pi (y + G_1)                                                   (b.9d)
    W_dot   = -[H Omega^-1 H^T]^-1 H Omega^-1 (y + G_1)                      (b.9f)
    qdd     = M^-1 (T' - J^T f)                                              (b.9e)

    The bias torques C are subtracted first, so J M^-1 T + G_1 becomes y + G_1 with T' in y.

    Raises:
        MethodNotApplicable: Omega is singular or too ill-conditioned.
    """
    s = Stacked(motion)
    arms = filtered_arms(motion)
    tips = concatenate(arm.free_tip() for arm in arms)

    omega = omega_recursive(s, arms)
    rhs = omega.solve(tips - s.a_prime + s.g)
    columns = omega.solve(s.HT)  # Omega^-1 H^T
    free = s.HT.T @ columns
    W_dot = -ldl_solve(ldl(free, np.diag(free)), s.HT.T @ rhs) if s.HT.shape[1] else np.zeros(0)
    f = rhs + columns @ W_dot  # (b.6b)

    qdd = [arm.accelerations(f_i) for arm, f_i in zip(arms, per_arm(f), strict=True)]
    return s.solution(concatenate(qdd), f, W_dot)
