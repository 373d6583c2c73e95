"""The paper's letters of a whole chain together with the oracle's answer, the truth of every identity."""

from __future__ import annotations

from functools import cache

import numpy as np

from holdfast.dynamics.closed.chain_motion import pseudo_gravity
from holdfast.dynamics.closed.stacked import Stacked
from tests.dynamics.problems import motion_of
from tests.oracles.maximal_kkt import solve
from tests.systems.problems import random_case, random_problem


class Answered:
    """Stacks over the arms (all hold); accelerations less [0; g], as in the paper.

    M is the joint mass matrix and MC the object's; T, C and T1 = T - C; qd, V0, VC; and the
    oracle's qdd, f, alpha_C, W_dot. alpha0 is J qdd + Jdot qd, the tips' side.
    """

    def __init__(self, seed: int, **options) -> None:
        case, problem = random_case(seed, **options), random_problem(seed, **options)
        motion = motion_of(problem)
        s = Stacked(motion)
        self.motion, self.stacked = motion, s
        self.J, self.M, self.A, self.MC, self.HT, self.g = s.J, s.M, s.A, s.M_C, s.HT, s.g
        self.b, self.a, self.Jdot_qd, self.T1, self.a1 = s.b, s.a, s.Jdot_qd, s.T_free, s.a_prime
        self.T = np.concatenate([arm.torque for arm in motion.holding])
        self.C = self.T - self.T1
        self.M1, self.MC1 = np.linalg.inv(self.M), np.linalg.inv(self.MC)
        self.V0 = np.concatenate([arm.tip_twist for arm in motion.holding])
        self.qd, self.VC = problem.state.qd, problem.state.object_twist
        self.W = np.concatenate([c.W for c in motion.contacts])

        answer = solve(case)
        self.qdd, self.f, self.W_dot = (np.concatenate(answer[key]) for key in ("qdd", "f", "W_dot"))
        self.alpha_C = answer["alpha_C"] - pseudo_gravity(problem.chain)
        self.alpha0 = self.J @ self.qdd + self.Jdot_qd

        self.Omega = self.J @ self.M1 @ self.J.T + self.A @ self.MC1 @ self.A.T
        self.Omega1 = np.linalg.inv(self.Omega)
        self.qdd_f = self.M1 @ self.T1
        self.alpha_f = self.J @ self.qdd_f + self.Jdot_qd
        self.I6, self.In = np.eye(len(self.f)), np.eye(len(self.T))


@cache
def rigid(seed: int) -> Answered:
    """Return 1 to 4 arms with rigid grasps, everything else on."""
    joints = (6, 7, 8, 6)[: 1 + seed % 4]
    return Answered(seed, grasps="rigid", joints=joints, gravity=(1.0, -2.0, -9.0), moving_base=seed % 2 == 0)


@cache
def nonrigid(seed: int) -> Answered:
    """Return 2 to 4 arms with mixed grasps, everything else on."""
    grasps = (("hinge", "ball"), ("softfinger", "hinge", "rigid"), ("ball", "softfinger", "hinge", "ball"))[seed % 3]
    joints = (7, 6, 8, 7)[: len(grasps)]
    return Answered(seed, grasps=grasps, joints=joints, gravity=(1.0, -2.0, -9.0), moving_base=seed % 2 == 0)
