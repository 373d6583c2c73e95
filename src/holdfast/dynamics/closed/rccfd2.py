"""Algorithm RCCFD 2 (6.18): torques and grasp forces are filtered together."""

from __future__ import annotations

from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution
from holdfast.dynamics.closed.omega import filtered_arms, omega_recursive, per_arm
from holdfast.dynamics.closed.stacked import Stacked
from holdfast.spatial.scalar import concatenate


def rccfd2(motion: ChainMotion) -> Solution:
    """Return the solution for rigid grasps by the cheapest recursion of the paper, O(n) + O(l^3).

    T'  = T - C                                                              (6.18a)
    f   = Omega^-1 {B^T psi^T H^T D^-1 (I - H Psi L) T' - a'(C)}             (6.18d)
    qdd = (I - H Psi L)^T D^-1 {T' - H psi (S L T' + B f)}                   (6.18e)

    Raises:
        MethodNotApplicable: Omega is singular or too ill-conditioned.
    """
    s = Stacked(motion)
    arms = filtered_arms(motion)
    tips = concatenate(arm.free_tip() for arm in arms)
    f = omega_recursive(s, arms).solve(tips - s.a_prime)
    qdd = [arm.accelerations(f_i) for arm, f_i in zip(arms, per_arm(f), strict=True)]
    return s.solution(concatenate(qdd), f)
