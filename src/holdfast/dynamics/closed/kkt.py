"""The solution of the dense system (2.11) with the contact freedoms of (b.1), O(n^3)."""

from __future__ import annotations

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution
from holdfast.dynamics.closed.stacked import Stacked
from holdfast.dynamics.trunk.whole_chain import of_whole_chain, whole_chain
from holdfast.errors import MethodNotApplicable
from holdfast.spatial.linalg import gauss_solve


def kkt(motion: ChainMotion) -> Solution:
    """Return the solution of the aggregate equations by Gaussian elimination with pivoting.

        [ 0     J    -A     H^T ] [ f       ]   [ a(C) - g - Jdot qd ]
        [ J^T   M     0     0   ] [ qdd     ] = [ T - C              ]
        [-A^T   0     M(C)  0   ] [ alpha_C ]   [ -b(C)              ]
        [ H     0     0     0   ] [ W_dot   ]   [ 0                  ]

    If H is empty, this is (2.11) with a correction (errata A). The matrix is regular exactly if f is unique. With a
    trunk, M, J and T - C are those of trunk and arms together.

    Raises:
        MethodNotApplicable: the matrix is singular.
    """
    s = Stacked(motion)
    M, T_free, J = whole_chain(motion, [*motion.chain.grasps, *motion.lone_on_trunk])
    l6, n, w = len(s.a), len(T_free), s.HT.shape[1]
    zeros = np.zeros
    matrix = np.block(
        [
            [zeros((l6, l6)), J, -s.A, s.HT],
            [J.T, M, zeros((n, 6)), zeros((n, w))],
            [-s.A.T, zeros((6, n)), s.M_C, zeros((6, w))],
            [s.HT.T, zeros((w, n)), zeros((w, 6)), zeros((w, w))],
        ]
    )
    rhs = np.concatenate([s.a - s.g - s.Jdot_qd, T_free, -s.b, zeros(w)])
    x, nullity = gauss_solve(matrix, rhs)
    if nullity:
        raise MethodNotApplicable(
            f"needs the KKT matrix regular (grasp forces unique), but its nullity is {nullity} of {len(rhs)};"
            " try method='sequential'"
        )
    f, qdd, alpha_C, W_dot = np.split(x, np.cumsum([l6, n, 6]))
    return of_whole_chain(motion, qdd, f, W_dot, alpha_C)
