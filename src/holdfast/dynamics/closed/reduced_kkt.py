"""The solution of the reduced system (2.14) for joint accelerations and grasp forces, with the object eliminated."""

from __future__ import annotations

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution
from holdfast.dynamics.closed.omega import omega_from_matrices
from holdfast.dynamics.closed.stacked import Stacked
from holdfast.spatial.linalg import gauss_solve


def reduced_kkt(motion: ChainMotion) -> Solution:
    """Return the solution of the reduced equations by Gaussian elimination, O(n^3).

        [ M   J^T              ] [ qdd ]   [ T'    ]
        [ J  -A M(C)^-1 A^T    ] [ f   ] = [ a'(C) ]                           (2.14)

    This holds for rigid grasps only. The Schur complement of the matrix is Omega, which must be regular.

    Raises:
        MethodNotApplicable: Omega is singular or too ill-conditioned.
    """
    s = Stacked(motion)
    omega_from_matrices(s)  # raises an error if (2.14) is not solvable
    matrix = np.block([[s.M, s.J.T], [s.J, -s.A @ s.M_C_inverse @ s.A.T]])
    x, _ = gauss_solve(matrix, np.concatenate([s.T_free, s.a_prime]))
    return s.solution(x[: len(s.M)], x[len(s.M) :])
