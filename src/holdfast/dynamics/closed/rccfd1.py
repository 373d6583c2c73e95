"""Algorithm RCCFD 1 (6.11): the general algorithm with a recursion for each step."""

from __future__ import annotations

from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution
from holdfast.dynamics.closed.omega import filtered_arms, omega_recursive, per_arm
from holdfast.dynamics.closed.stacked import Stacked
from holdfast.spatial.scalar import concatenate


def rccfd1(motion: ChainMotion) -> Solution:
    """Return the solution for rigid grasps as free motion plus correction, O(n) + O(l^3).

    1. T' = T - C;  qdd_f = (I - H Psi L)^T D^-1 (I - H Psi L) T';  alpha_f     (6.11a-c)
    2. Omega f = alpha_f + A M(C)^-1 b(C) - a(C)                              (6.11d-f)
    3. dqdd = -(I - H Psi L)^T D^-1 H psi B f                                 (6.11g)
    4. qdd = qdd_f + dqdd                                                     (6.11i)

    Raises:
        MethodNotApplicable: Omega is singular or too ill-conditioned.
    """
    s = Stacked(motion)
    arms = filtered_arms(motion)

    free = [arm.smoothed(arm.residual(arm.T_free)) for arm in arms]
    alpha_f = concatenate(tip + arm.motion.bias.tip_acceleration for arm, (_, tip) in zip(arms, free, strict=True))

    f = omega_recursive(s, arms).solve(alpha_f - s.A @ s.object_free - s.a)

    # residual(0, f) = -H psi B f includes the sign that is missing in the printed (6.11g)
    changes = [arm.smoothed(arm.residual(None, f_i))[0] for arm, f_i in zip(arms, per_arm(f), strict=True)]
    qdd = [qdd_f + change for (qdd_f, _), change in zip(free, changes, strict=True)]
    return s.solution(concatenate(qdd), f)
