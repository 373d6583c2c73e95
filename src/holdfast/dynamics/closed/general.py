"""The general four-step algorithm (4.9), which uses any open-chain forward dynamics."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from holdfast.dynamics.arm.free_dynamics import tip_acceleration
from holdfast.dynamics.arm.motion import ArmMotion, at_rest
from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution
from holdfast.dynamics.closed.omega import Omega
from holdfast.dynamics.closed.stacked import Stacked, block_diagonal
from holdfast.spatial.scalar import Array, array, concatenate

# function of the arm's motion, torques T (N,) and the tip wrench f (6,) of the arm on the object that returns qdd (N,)
FreeDynamics = Callable[[ArmMotion, Array, Array], Array]


def general(motion: ChainMotion, free_dynamics: FreeDynamics) -> Solution:
    """Return the closed-chain solution for rigid grasps, using only an open-chain solver.

    1. M qdd_f + C = T,  alpha_f = J qdd_f + Jdot qd                 (4.9a, b)
    2. Omega f = alpha_f + A M(C)^-1 b(C) - a(C)                     (4.9c, d)
    3. M dqdd + J^T f = 0                                            (4.9e)
    4. qdd = qdd_f + dqdd                                            (4.9g)

    J M^-1 J^T is computed with the same solver, from six unit wrenches at the tip of each arm at rest.

    Args:
        motion: the chain's motion.
        free_dynamics: any open-chain forward dynamics.

    Raises:
        MethodNotApplicable: Omega is singular or too ill-conditioned.
    """
    s = Stacked(motion)
    arms = motion.holding
    free = [free_dynamics(arm, arm.torque, np.zeros(6)) for arm in arms]
    alpha_f = [tip_acceleration(arm, qdd) for arm, qdd in zip(arms, free, strict=True)]

    resting = [at_rest(arm) for arm in arms]

    def change(arm: ArmMotion, f: Array) -> Array:
        return free_dynamics(arm, arm.torque, f)

    mobilities = [
        array([-J @ change(arm, unit) for unit in np.eye(6)]).T for arm, J in zip(resting, s.J_blocks, strict=True)
    ]
    omega = Omega(block_diagonal(mobilities) + s.A @ s.M_C_inverse @ s.A.T)
    f = omega.solve(concatenate(alpha_f) - s.A @ s.object_free - s.a)
    qdd = [qdd_f + change(arm, f[6 * i : 6 * i + 6]) for i, (arm, qdd_f) in enumerate(zip(resting, free, strict=True))]
    return s.solution(concatenate(qdd), f)
