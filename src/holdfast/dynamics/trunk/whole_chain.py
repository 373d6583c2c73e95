"""The equations of trunk and arms as dense matrices, for the method `kkt`.

With the acceleration beta of an arm's base as a further unknown, the arm's equations are M qdd + B^T beta + C + J^T f =
T, and the wrench of the trunk on it is B qdd + I beta + w (docs/theory/trunk.md). With beta = S u, where u are the
accelerations of the floating base and of the trunk's joints, the mass matrix of trunk and arms is

    [ M_t + sum S_i^T I_i S_i    S_1^T B_1   S_2^T B_2 .. ]
    [ B_1^T S_1                  M_1                      ]
    [ ..                                        M_2       ]
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.bias import bias_torque
from holdfast.dynamics.arm.forward_kinematics import jacobian
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.arm.motion import ArmMotion
from holdfast.dynamics.closed.chain_motion import ChainMotion, Solution
from holdfast.dynamics.closed.stacked import block_diagonal
from holdfast.dynamics.trunk.trunk_motion import TrunkAcceleration, TrunkMotion
from holdfast.questions.arrays import starts
from holdfast.spatial.scalar import Array, array, concatenate
from holdfast.spatial.spatial_vector import rotate, shift_twist, shift_wrench, twist_shift


class WholeChain(NamedTuple):
    """Mass matrix, torques and tip Jacobians for u (floating base, trunk's joints) and the joints of all arms.

    Attributes:
        M: (m, m) with m = n, or n + 6 with a floating base.
        T_free: (m,) torques minus the bias torques; for a floating base, minus its bias wrench.
        J: (6l, m) Jacobians of the contact points of the arms with a grasp, world axes.
    """

    M: Array
    T_free: Array
    J: Array


class OnBase(NamedTuple):
    """The wrench of an arm's base, B qdd + I beta + w: B (6, N), I (6, 6) with locked joints, and w (6,) at qdd = 0."""

    B: Array
    I: Array
    w: Array


def whole_chain(motion: ChainMotion, arms: Sequence[str] | None = None) -> WholeChain:
    """Return the matrices of trunk and arms. O(n^2).

    Args:
        motion: the chain's motion.
        arms: names of the arms in order, those with a grasp among them; None for all.
    """
    grasps, names = motion.chain.grasps, [*motion.arms] if arms is None else arms
    S, M_t, T_t = of_trunk(motion.trunk)
    none, across, torques = np.zeros((6, len(T_t))), [np.zeros((len(T_t), 0))], []
    for name, arm in ((name, motion.arms[name]) for name in names):
        torques.append(arm.torque - bias_torque(arm.arm, arm.at, arm.bias.wrenches)[0])
        across.append(np.zeros((len(T_t), len(torques[-1]))))
        if name in S:
            at_base, columns = on_base(arm), S[name]
            M_t, T_t = M_t + columns.T @ at_base.I @ columns, T_t - columns.T @ at_base.w
            across[-1] = columns.T @ at_base.B
    whole, M_a = (
        np.hstack(across),
        block_diagonal([mass_matrix(motion.arms[n].arm, motion.arms[n].at)[0] for n in names]),
    )
    J_t = [twist_shift(motion.arms[name].base_to_tip) @ S.get(name, none) for name in grasps]
    J_a = [jacobian(motion.arms[n].arm, motion.arms[n].at)[: 6 if n in grasps else 0] for n in names]
    J = np.hstack([np.concatenate([none[:0], *J_t]), block_diagonal(J_a)])
    return WholeChain(np.block([[M_t, whole], [whole.T, M_a]]), concatenate([T_t, *torques]), J)


def of_whole_chain(motion: ChainMotion, u: Array, f: Array, W_dot: Array, alpha_C: Array) -> Solution:
    """Return the solution from stacked results.

    Args:
        motion: the chain's motion.
        u: (m,) accelerations of the floating base, of the trunk's joints, and of the arms with a grasp, at least.
        f: (6l,) grasp wrenches.
        W_dot: W_dot of all grasps, flat.
        alpha_C: (6,) alpha(C) minus [0; g].
    """
    first = 6 if motion.trunk.floats else 0
    ends = starts([first + motion.trunk.joints.stop, *(arm.arm.joint_count for arm in motion.holding)])[1:]
    of_trunk = TrunkAcceleration(u[first : ends[0]], u[:6] if first else None)
    qdd = [u[begin:end] for begin, end in pairwise(ends)]
    return Solution(qdd, list(f.reshape(-1, 6)), alpha_C, W_dot, trunk=of_trunk)


def of_trunk(trunk: TrunkMotion) -> tuple[dict[str, Array], Array, Array]:
    """Return beta = S u at the base of each mounted arm, and the trunk's own mass matrix and torques."""
    S = {name: np.hstack(trunk.jacobian(name, np.zeros(3))[::-1]) for name in trunk.mounts}
    joints = [body.joint for body in trunk.bodies if body.joint is not None]
    first = 6 if trunk.floats else 0
    size = first + len(joints)
    M = np.diag([*[0.0] * first, *(joint.armature for joint in joints)])
    T = array([*[0.0] * first, *(body.torque for body in trunk.bodies if body.joint is not None)])
    moved = [np.zeros(6)] * size
    for k, body in enumerate(trunk.bodies):
        moved = [shift_twist(body.reach, column) for column in moved]
        if body.H is None:
            moved[:6] = list(np.eye(6))
        else:
            moved[first + k - trunk.floats] = body.H
        columns = array(moved).T
        M = M + columns.T @ body.inertia.symmetric().dense() @ columns
        T = T - columns.T @ body.wrench
    return S, M, T


def on_base(arm: ArmMotion) -> OnBase:
    """Return the matrices of the wrench at the base of an arm."""
    at, base = arm.at, arm.arm.base.R
    if not arm.arm.joints:
        of_base = arm.bias.of_base
        return OnBase(np.zeros((6, 0)), np.zeros((6, 6)), np.zeros(6) if of_base is None else rotate(base, of_base))
    _, per_joint, locked = mass_matrix(arm.arm, at)
    _, at_rest = bias_torque(arm.arm, at, arm.bias.wrenches)
    first = base @ at.l[0]
    B = array([shift_wrench(first, rotate(at.R[0], column)) for column in per_joint.T]).T
    return OnBase(B, locked.symmetric().rotated(base).dense(), shift_wrench(first, rotate(at.R[0], at_rest)))
