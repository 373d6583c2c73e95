"""The computation of `holding_torques` for chains with all joints driven and no floating base, also in machine code."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.control.computed_torque import joint_accelerations
from holdfast.dynamics.arm.forward_kinematics import jacobian
from holdfast.dynamics.closed.chain_motion import ChainMotion, needed_wrench, pseudo_gravity
from holdfast.dynamics.constraint import length_scale
from holdfast.dynamics.inverse import torques
from holdfast.spatial.linalg import least_solution
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, maximum
from holdfast.spatial.spatial_vector import rotate, shift_twist, shift_wrench
from holdfast.spatial.vector import largest

FEASIBLE = 1e-8  # largest accepted residual of a balance, relative to its terms
Missed = tuple[Scalar, Scalar]  # largest component of a tip's acceleration error, and the size for comparison


class Balanced(NamedTuple):
    """Torques with the residuals of the equations that they should satisfy.

    Attributes:
        tau: (n,) torques [N m or N].
        missed: per arm with a grasp, the acceleration error of its tip, and the size for comparison.
        left: largest component of the load that no wrench balances, with moments divided by the grasps' distance [N].
        size: size of loads and wrenches, at least 1 [N].
    """

    tau: Array
    missed: list[Missed]
    left: Scalar
    size: Scalar


def balanced(motion: ChainMotion, alpha: Array, wished: Array) -> Balanced:
    """Return tau = M qdd + C + J^T f + damping qd + stiffness (q - rest), with the smallest qdd and the nearest f.

    Args:
        motion: the chain's motion, without torques.
        alpha: (6,) true acceleration of C, world axes.
        wished: (arms, 6) wrenches about the contacts, world axes, to which f shall be as close as possible.
    """
    qdd = joint_accelerations(motion, alpha - pseudo_gravity(motion.chain), np.zeros(motion.chain.joint_count))
    f, left, size = bearing_wrenches(motion, alpha, wished)
    return Balanced(torques(motion, qdd, f), missed_accelerations(motion, qdd, alpha), left, size)


def bearing_wrenches(motion: ChainMotion, alpha: Array, wished: Array) -> tuple[Array, Scalar, Scalar]:
    """Return the transmissible wrenches nearest to the wished ones that move the object, the residual, and its scale.

    Args:
        motion: the chain's motion.
        alpha: (6,) true acceleration of C, world axes.
        wished: (arms, 6) wished wrenches about the contacts, world axes.
    """
    return nearest_wrenches(motion, needed_wrench(motion, alpha), wished)


def nearest_wrenches(motion: ChainMotion, net: Array, wished: Array) -> tuple[Array, Scalar, Scalar]:
    """Return the transmissible wrenches nearest to the wished ones with a given sum at C, the residual, and its scale.

    min |lambda - K f_wished| in the metric of the force split, subject to A^T K^T lambda = net; for net = 0, the
    internal part of the wished wrenches. One step of iterative refinement restores the digits that are lost in forming
    A A^T.

    Args:
        motion: the chain's motion.
        net: (6,) their sum about C, world axes.
        wished: (arms, 6) wished wrenches about the contacts, world axes.
    """
    chain = motion.chain
    length = length_scale([grasp.frame.p for grasp in chain.grasps.values()])
    unit = np.r_[np.full(3, 1 / length), np.ones(3)]  # moments in newtons
    needed = unit * net
    rows, at_C, start = [], [], []
    root = np.array([x for c in motion.contacts for x in c.grasp.of_kind.row_scales(length)])
    for name, c in zip(chain.grasps, motion.contacts, strict=True):
        K = c.K
        rows.append(K)
        at_C.extend(unit * shift_wrench(c.offset, row) for row in K)
        start.append(K @ wished[chain.names.index(name)])
    if not len(root):
        return np.zeros((len(chain.arms), 6)), largest(needed), maximum(1.0, largest(needed))
    E, lam = array(at_C).T, concatenate(start)
    for _ in range(2):
        lam = lam + root * least_solution(E * root, needed - E @ lam)
    parts = np.split(lam, np.cumsum([len(K) for K in rows])[:-1])
    found = {name: K.T @ part for name, K, part in zip(chain.grasps, rows, parts, strict=True) if len(K)}
    f = array([found.get(name, np.zeros(6)) for name in chain.names])
    return f, largest(needed - E @ lam), maximum(maximum(1.0, largest(needed)), largest(lam))


def internal_part(motion: ChainMotion, wrenches: Array) -> Array:
    """Return the part of grasp wrenches that does not move the object, (arms, 6)."""
    return nearest_wrenches(motion, np.zeros(6), wrenches)[0]


def sum_at_object(motion: ChainMotion, wrenches: Array) -> Array:
    """Return the sum about C of given grasp wrenches (arms, 6), (6,); without bushings, which the motion contains."""
    grasps = zip(motion.chain.grasps, motion.contacts, strict=True)
    rigid = [(name, c) for name, c in grasps if not c.grasp.of_kind.compliant]
    at_C = [shift_wrench(c.offset, wrenches[motion.chain.names.index(name)]) for name, c in rigid]
    return sum(at_C, start=np.zeros(6))


def missed_accelerations(motion: ChainMotion, qdd: Array, alpha: Array) -> list[Missed]:
    """Return the acceleration error of each arm's tip and the size for comparison, for all arms with a grasp."""
    free_fall, found = alpha - pseudo_gravity(motion.chain), []
    for name, c in zip(motion.chain.grasps, motion.contacts, strict=True):
        arm = motion.arms[name]
        tip = shift_twist(c.offset, free_fall) + c.a - c.g - arm.bias.tip_acceleration
        gap = c.transmitted(tip - jacobian(arm.arm, arm.at) @ qdd[motion.chain.joints[name]])  # no trunk accelerates
        found.append((largest(gap), maximum(1.0, largest(tip))))
    return found


def pushes(motion: ChainMotion, push: Scalar) -> Array:
    """Return a push of every arm along its contact normal into the object, (arms, 6); zero for bushings."""
    wished = dict.fromkeys(motion.chain.names, np.zeros(6))
    for name, c in zip(motion.chain.grasps, motion.contacts, strict=True):
        if not c.grasp.of_kind.compliant:  # the wrench of a bushing follows from the state
            wished[name] = rotate(c.R, array([0.0, 0.0, 0.0, 0.0, 0.0, push]))
    return array(list(wished.values()))
