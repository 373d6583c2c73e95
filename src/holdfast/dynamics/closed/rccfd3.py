"""Algorithm RCCFD 3 (6.22): the answers to T' and to a'(C) apart, then added."""

from __future__ import annotations

from holdfast.dynamics.arm.articulated import articulated_filter, smooth, whiten
from holdfast.dynamics.arm.bias import bias_torque
from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution
from holdfast.dynamics.closed.omega import omega_recursive
from holdfast.dynamics.closed.stacked import Stacked
from holdfast.spatial.scalar import concatenate
from holdfast.spatial.spatial_vector import rotate, unrotate


def rccfd3(motion: ChainMotion) -> Solution:
    """Return the solution as a sum of two, O(n) + O(l^3), rigid grasps.

    zeta = Omega^-1 a'(C)                                                         (6.22d)
    f    = Omega^-1 B^T psi^T H^T D^-1 (I - H Psi L) T' - zeta                    (6.22e)
    qdd1 = (I - H Psi L)^T {D^-1 - D^-1 H psi B Omega^-1 B^T psi^T H^T D^-1}
           (I - H Psi L) T'                                                       (6.22f)
    qdd2 = (I - H Psi L)^T D^-1 H psi B zeta,   qdd = qdd1 + qdd2                 (6.22g, h)

    Raises:
        MethodNotApplicable: if Omega is singular or has lost its digits.
    """
    s = Stacked(motion)
    arms = motion.holding
    filters = [articulated_filter(arm.arm, arm.at) for arm in arms]
    omega = omega_recursive(motion, s, filters)
    zeta = omega.solve(s.a_prime)

    residuals, tips = [], []
    for arm, filter in zip(arms, filters, strict=True):
        C, _ = bias_torque(arm.arm, arm.at, arm.bias.wrenches)
        eps, _ = whiten(arm.arm, arm.at, filter, arm.torque - C, None, None)
        residuals.append(eps)
        tips.append(rotate(arm.at.R[-1], smooth(arm.arm, arm.at, filter, eps / filter.D)[1]))
    x = omega.solve(concatenate(tips))

    qdd = []
    for i, (arm, filter, eps) in enumerate(zip(arms, filters, residuals, strict=True)):
        R, part = arm.at.R[-1], slice(6 * i, 6 * i + 6)
        minus_HpsiB_x, _ = whiten(arm.arm, arm.at, filter, None, None, unrotate(R, x[part]))
        minus_HpsiB_zeta, _ = whiten(arm.arm, arm.at, filter, None, None, unrotate(R, zeta[part]))
        qdd1, _ = smooth(arm.arm, arm.at, filter, (eps + minus_HpsiB_x) / filter.D)
        qdd2, _ = smooth(arm.arm, arm.at, filter, -minus_HpsiB_zeta / filter.D)
        qdd.append(qdd1 + qdd2)
    return s.solution(concatenate(qdd), x - zeta)
