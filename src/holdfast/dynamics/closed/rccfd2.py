"""Algorithm RCCFD 2 (6.18): one filtering of torques and grasp forces together."""

from __future__ import annotations

from holdfast.dynamics.arm.articulated import articulated_filter, smooth, whiten
from holdfast.dynamics.arm.bias import bias_torque
from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution
from holdfast.dynamics.closed.omega import omega_recursive
from holdfast.dynamics.closed.stacked import Stacked
from holdfast.spatial.scalar import concatenate
from holdfast.spatial.spatial_vector import rotate, unrotate


def rccfd2(motion: ChainMotion) -> Solution:
    """Return the cheapest of the paper's recursions, O(n) + O(l^3), rigid grasps.

    T'  = T - C                                                              (6.18a)
    f   = Omega^-1 {B^T psi^T H^T D^-1 (I - H Psi L) T' - a'(C)}             (6.18d)
    qdd = (I - H Psi L)^T D^-1 {T' - H psi (S L T' + B f)}                   (6.18e)

    Raises:
        MethodNotApplicable: if Omega is singular or has lost its digits.
    """
    s = Stacked(motion)
    arms = motion.holding
    filters = [articulated_filter(arm.arm, arm.at) for arm in arms]
    T_free = [arm.torque - bias_torque(arm.arm, arm.at, arm.bias.wrenches)[0] for arm in arms]

    tips = []  # J M^-1 T'
    for arm, filter, T in zip(arms, filters, T_free, strict=True):
        eps, _ = whiten(arm.arm, arm.at, filter, T, None, None)
        tips.append(rotate(arm.at.R[-1], smooth(arm.arm, arm.at, filter, eps / filter.D)[1]))

    f = omega_recursive(motion, s, filters).solve(concatenate(tips) - s.a_prime)

    qdd = []
    for i, (arm, filter, T) in enumerate(zip(arms, filters, T_free, strict=True)):
        eps, _ = whiten(arm.arm, arm.at, filter, T, None, unrotate(arm.at.R[-1], f[6 * i : 6 * i + 6]))
        qdd.append(smooth(arm.arm, arm.at, filter, eps / filter.D)[0])
    return s.solution(concatenate(qdd), f)
