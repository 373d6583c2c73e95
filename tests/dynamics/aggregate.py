"""The paper's letters for a whole chain: operators of all arms as block diagonals.

Within an arm joints count from tip to base, as in the paper. What the identities are held
against (Ms, J, C, Jdot_qd) comes from the sweeps, which are tested on their own.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from holdfast.dynamics.arm.bias import bias_torque
from holdfast.dynamics.arm.jacobian import jacobian
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.closed.stacked import Stacked, block_diagonal
from holdfast.dynamics.operators import ArmOperators
from tests.dynamics.problems import inputs_of, motion_of, random_problem
from tests.systems.as_chain import Problem

BACK = slice(None, None, -1)


class Aggregate:
    """Operators, matrices and vectors of (5.1)-(5.5) and (6.1)-(6.22), world axes.

    Script M is `Ms`, the links' M is `M`; `b` is less the links' external wrenches. T' is
    `T1`, a'(C) is `a1`, I - H Psi L is `K`; f is any stack of tip wrenches.
    """

    def __init__(self, problem: Problem, seed: int) -> None:
        motion = motion_of(problem)
        self.arms = [ArmOperators(inputs_of(problem, name)) for name in problem.chain.grasps]
        for letter in ("H", "phi", "M", "S", "B", "armature", "D", "L", "psi", "Phi", "Psi", "P", "G"):
            setattr(self, letter, block_diagonal([getattr(arm, letter) for arm in self.arms]))
        self.a = np.concatenate([arm.a for arm in self.arms])
        self.a0 = np.concatenate([arm.a0 for arm in self.arms])
        self.b = np.concatenate([arm.b - arm.given.link_wrenches[BACK].ravel() for arm in self.arms])

        holding = motion.holding
        self.Ms = block_diagonal([mass_matrix(arm.arm, arm.at)[0][BACK, BACK] for arm in holding])
        self.J = block_diagonal([jacobian(arm.arm, arm.at)[:, BACK] for arm in holding])
        self.C = np.concatenate([bias_torque(arm.arm, arm.at, arm.bias.wrenches)[0][BACK] for arm in holding])
        self.T = np.concatenate([arm.torque[BACK] for arm in holding])
        self.Jdot_qd = np.concatenate([arm.bias.tip_acceleration for arm in holding])

        stacked = Stacked(motion)
        self.A, self.MC1, self.a1 = stacked.A, stacked.M_C_inverse, stacked.a_prime
        self.T1 = self.T - self.C
        self.I = np.eye(len(self.T))
        self.K = self.I - self.H @ self.Psi @ self.L
        self.D1 = np.linalg.inv(self.D)
        self.Ms1 = np.linalg.inv(self.Ms)
        self.Omega = self.J @ self.Ms1 @ self.J.T + self.A @ self.MC1 @ self.A.T
        self.Omega1 = np.linalg.inv(self.Omega)
        self.f = 10 * np.random.default_rng(seed).normal(size=len(self.a1))
        self.free = self.Ms1 @ self.T1  # the free accelerations


@cache
def aggregate(seed: int) -> Aggregate:
    """Return a random chain of rigid grasps: prismatic joints, moving bases, oblique gravity, wrenches."""
    options = {"grasps": "rigid", "joints": (7, 6, 8)[: 1 + seed % 3], "moving_base": True}
    return Aggregate(random_problem(seed, gravity=(1.0, -2.0, -9.0), **options), seed)
