"""What `holding_torques` computes where every joint is driven and no base floats, on floats and as machine code."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from holdfast.control.computed_torque import joint_accelerations
from holdfast.dynamics.arm.jacobian import jacobian
from holdfast.dynamics.closed.chain_motion import ChainMotion, pseudo_gravity
from holdfast.dynamics.constraint import length_scale
from holdfast.dynamics.inverse import torques
from holdfast.spatial.linalg import least_solution
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, maximum
from holdfast.spatial.spatial_vector import rotate, shift_twist, shift_wrench

POSSIBLE = 1e-8  # of the sizes at hand: what may be left of a balance
Missed = tuple[Scalar, Scalar]  # the largest entry of what an arm's tip misses, and the size it is to be compared with


class Balanced(NamedTuple):
    """Torques, and how nearly they do what they should.

    Attributes:
        tau: (n,) [N m or N].
        missed: per arm that holds, what its tip misses of the acceleration, and the size of that.
        left: largest part of the load that no wrench bears, moments over the grasps' distance [N].
        size: of loads and wrenches, at least 1 [N].
    """

    tau: Array
    missed: list[Missed]
    left: Scalar
    size: Scalar


def balanced(motion: ChainMotion, qd: Array, alpha: Array, wished: Array) -> Balanced:
    """Return tau = M qdd + C + J^T f + damping qd + stiffness (q - rest), with the least qdd and the nearest f.

    Args:
        motion: the chain in motion, without torques.
        qd: (n,) joint rates.
        alpha: (6,) acceleration of C, true, world axes.
        wished: (arms, 6) about the contacts, world axes: the wrenches that f shall be near.
    """
    qdd = joint_accelerations(motion, qd, alpha - pseudo_gravity(motion.chain))
    f, left, size = bearing_wrenches(motion, alpha, wished)
    return Balanced(torques(motion, qdd, f), missed_accelerations(motion, qdd, alpha), left, size)


def bearing_wrenches(motion: ChainMotion, alpha: Array, wished: Array) -> tuple[Array, Scalar, Scalar]:
    """Return the transmissible wrenches nearest to the wished ones that carry the object, what is left, and its size.

    min |lambda - K f_wished| in the metric of the force split, A^T K^T lambda = M(C) (alpha - [0; g]) + b(C) - w. The
    residual of the first solution is solved for once more, which restores the digits that forming A A^T loses.

    Args:
        motion: the chain in motion.
        alpha: (6,) acceleration of C, true, world axes.
        wished: (arms, 6) about the contacts, world axes.
    """
    chain, body = motion.chain, motion.body
    length = length_scale([grasp.frame.p for grasp in chain.grasps.values()])
    unit = np.r_[np.full(3, 1 / length), np.ones(3)]  # moments in newtons
    needed = unit * (body.inertia.apply(alpha - pseudo_gravity(chain)) + body.bias - body.wrench)
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


def missed_accelerations(motion: ChainMotion, qdd: Array, alpha: Array) -> list[Missed]:
    """Return what each arm's tip misses of the object's acceleration, and the size of it, arms that hold in order."""
    free_fall, found = alpha - pseudo_gravity(motion.chain), []
    for name, c in zip(motion.chain.grasps, motion.contacts, strict=True):
        arm = motion.arms[name]
        tip = shift_twist(c.offset, free_fall) + c.a - c.g - arm.bias.tip_acceleration
        gap = c.transmitted(tip - jacobian(arm.arm, arm.at) @ qdd[motion.chain.joints[name]])  # no trunk accelerates
        found.append((largest(gap), maximum(1.0, largest(tip))))
    return found


def pushes(motion: ChainMotion, push: Scalar) -> Array:
    """Return a push of every arm along its contact normal, into the object, (arms, 6); none by a bushing."""
    wished = dict.fromkeys(motion.chain.names, np.zeros(6))
    for name, c in zip(motion.chain.grasps, motion.contacts, strict=True):
        if not c.grasp.of_kind.compliant:  # that exerts what the state says
            wished[name] = rotate(c.R, array([0.0, 0.0, 0.0, 0.0, 0.0, push]))
    return array(list(wished.values()))


def largest(x: Iterable[Scalar]) -> Scalar:
    """Return the largest size of some numbers, 0 of none."""
    found: Scalar = 0.0
    for entry in x:
        found = maximum(found, abs(entry))
    return found
