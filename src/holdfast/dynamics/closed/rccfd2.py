"""Algorithm RCCFD 2 (6.18): one filtering of torques and grasp forces together."""

from __future__ import annotations

from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution
from holdfast.dynamics.closed.filtered_arm import filtered_arms, per_arm
from holdfast.dynamics.closed.omega import omega_recursive
from holdfast.dynamics.closed.stacked import Stacked
from holdfast.spatial.scalar import concatenate


def rccfd2(motion: ChainMotion) -> Solution:
    """Return the cheapest of the paper's recursions, O(n) + O(l^3), rigid grasps.

    T'  = T - C                                                              (6.18a)
    f   = Omega^-1 {B^T psi^T H^T D^-1 (I - H Psi L) T' - a'(C)}             (6.18d)
    qdd = (I - H Psi L)^T D^-1 {T' - H psi (S L T' + B f)}                   (6.18e)

    Raises:
        MethodNotApplicable: if Omega is singular or has lost its digits.
    """
    s = Stacked(motion)
    arms = filtered_arms(motion)
    tips = concatenate(arm.free_tip() for arm in arms)
    f = omega_recursive(s, arms).solve(tips - s.a_prime)
    qdd = [arm.accelerations(f_i) for arm, f_i in zip(arms, per_arm(f), strict=True)]
    return s.solution(concatenate(qdd), f)
