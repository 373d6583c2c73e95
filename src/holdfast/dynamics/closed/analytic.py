"""The analytical solution of the closed-chain dynamics (3.6)."""

from __future__ import annotations

from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution
from holdfast.dynamics.closed.omega import omega_from_matrices
from holdfast.dynamics.closed.stacked import Stacked


def analytic(motion: ChainMotion) -> Solution:
    """Return the closed form for rigid grasps, O(n^3).

    f   = Omega^-1 J M^-1 T' - Omega^-1 a'(C)                                  (3.6b)
    qdd = (M^-1 - M^-1 J^T Omega^-1 J M^-1) T' + M^-1 J^T Omega^-1 a'(C)       (3.6a)

    Raises:
        MethodNotApplicable: Omega is singular or too ill-conditioned.
    """
    s = Stacked(motion)
    omega = omega_from_matrices(s)
    free = s.mass_solve(s.T_free)
    f = omega.solve(s.J @ free) - omega.solve(s.a_prime)
    qdd = free - s.mass_solve(s.J.T @ f)
    return s.solution(qdd, f)
