"""Algorithm RCCFD 1 (6.11): the general algorithm, each step a recursion."""

from __future__ import annotations

from holdfast.dynamics.arm.articulated import articulated_filter, smooth, whiten
from holdfast.dynamics.arm.bias import bias_torque
from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution
from holdfast.dynamics.closed.omega import omega_recursive
from holdfast.dynamics.closed.stacked import Stacked
from holdfast.spatial.scalar import concatenate
from holdfast.spatial.spatial_vector import rotate, unrotate


def rccfd1(motion: ChainMotion) -> Solution:
    """Return the solution by free motion plus correction, O(n) + O(l^3), rigid grasps.

    1. T' = T - C;  qdd_f = (I - H Psi L)^T D^-1 (I - H Psi L) T';  alpha_f     (6.11a-c)
    2. Omega f = alpha_f + A M(C)^-1 b(C) - a(C)                              (6.11d-f)
    3. dqdd = -(I - H Psi L)^T D^-1 H psi B f                                 (6.11g)
    4. qdd = qdd_f + dqdd                                                     (6.11i)

    Raises:
        MethodNotApplicable: if Omega is singular or has lost its digits.
    """
    s = Stacked(motion)
    arms = motion.holding
    filters = [articulated_filter(arm.arm, arm.at) for arm in arms]

    free, alpha_f = [], []
    for arm, filter in zip(arms, filters, strict=True):
        C, _ = bias_torque(arm.arm, arm.at, arm.bias.wrenches)
        eps, _ = whiten(arm.arm, arm.at, filter, arm.torque - C, None, None)
        qdd_f, tip = smooth(arm.arm, arm.at, filter, eps / filter.D)
        free.append(qdd_f)
        alpha_f.append(rotate(arm.at.R[-1], tip) + arm.bias.tip_acceleration)

    omega = omega_recursive(motion, s, filters)
    f = omega.solve(concatenate(alpha_f) - s.A @ s.object_free - s.a)

    qdd = []
    for i, (arm, filter) in enumerate(zip(arms, filters, strict=True)):
        # whiten(0, f) = -H psi B f, the sign that (6.11g) lacks in print
        share, _ = whiten(arm.arm, arm.at, filter, None, None, unrotate(arm.at.R[-1], f[6 * i : 6 * i + 6]))
        change, _ = smooth(arm.arm, arm.at, filter, share / filter.D)
        qdd.append(free[i] + change)
    return s.solution(concatenate(qdd), f)
