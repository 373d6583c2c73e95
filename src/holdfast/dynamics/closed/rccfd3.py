"""Algorithm RCCFD 3 (6.22): the sum of the responses to T' and to a'(C)."""

from __future__ import annotations

from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution
from holdfast.dynamics.closed.omega import filtered_arms, omega_recursive, per_arm
from holdfast.dynamics.closed.stacked import Stacked
from holdfast.spatial.scalar import concatenate


def rccfd3(motion: ChainMotion) -> Solution:
    """Return the solution for rigid grasps as the sum of two responses, O(n) + O(l^3).

    zeta = Omega^-1 a'(C)                                                         (6.22d)
    f    = Omega^-1 B^T psi^T H^T D^-1 (I - H Psi L) T' - zeta                    (6.22e)
    qdd1 = (I - H Psi L)^T {D^-1 - D^-1 H psi B Omega^-1 B^T psi^T H^T D^-1}
           (I - H Psi L) T'                                                       (6.22f)
    qdd2 = (I - H Psi L)^T D^-1 H psi B zeta,   qdd = qdd1 + qdd2                 (6.22g, h)

    Raises:
        MethodNotApplicable: Omega is singular or too ill-conditioned.
    """
    s = Stacked(motion)
    arms = filtered_arms(motion)
    omega = omega_recursive(s, arms)
    zeta = omega.solve(s.a_prime)

    residuals = [arm.residual(arm.T_free) for arm in arms]
    tips = concatenate(arm.smoothed(eps)[1] for arm, eps in zip(arms, residuals, strict=True))
    x = omega.solve(tips)

    qdd = []
    for arm, eps, x_i, zeta_i in zip(arms, residuals, per_arm(x), per_arm(zeta), strict=True):
        # residual(0, v) = -H psi B v
        qdd1, _ = arm.smoothed(eps + arm.residual(None, x_i))
        qdd2, _ = arm.smoothed(-arm.residual(None, zeta_i))
        qdd.append(qdd1 + qdd2)
    return s.solution(concatenate(qdd), x - zeta)
