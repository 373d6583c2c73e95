"""The grasp constraint on velocities: K_i J_i qd_i = K_i A_i V(C), arm by arm.

With the relative rates W as unknowns it reads [J, -A, H^T] (qd, V(C), W) = base motion, six
rows a grasp; K takes W out. rank[J, -A, H^T] = rank K[J, -A] + sum n_g.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.jacobian import jacobian
from holdfast.dynamics.closed.chain_motion import ChainMotion
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import twist_shift

SMALLEST_LENGTH = 1e-3  # m: what is smaller sets no scale


class ConstraintRows(NamedTuple):
    """Rows of K [J, -A] over all joints and V(C), one block a grasp, in order.

    Attributes:
        joints: (rows, n).
        object: (rows, 6).
        slices: per grasp, where its rows lie.
    """

    joints: Array
    object: Array
    slices: list[slice]


def coordinate_sizes(motion: ChainMotion) -> Array:
    """Return what counts as one unit of each joint and of [turn; shift] of the object, (n + 6,).

    1 rad for what turns; for what slides the longest reach of an arm, or of the object to a grasp if that is longer
    [m], so that no step, norm or rank depends on the unit of length.
    """
    reach = [r for arm in motion.arms.values() for r in arm.at.reach] + [c.offset for c in motion.contacts]
    length = max(float(np.linalg.norm(r)) for r in reach)
    length = length if length > SMALLEST_LENGTH else 1.0
    joints = [1.0 if joint.turns else length for arm in motion.chain.arms.values() for joint in arm.joints]
    return np.array([*joints, 1.0, 1.0, 1.0, length, length, length])


def length_scale(offsets: list[Array]) -> float:
    """Return L: rms distance of the contact points from their centroid [m].

    One contact, or contacts in one point, have no such distance: 1 m is taken.
    """
    if len(offsets) < 2:
        return 1.0
    points = np.array(offsets)
    L = float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()))
    return L if L > SMALLEST_LENGTH else 1.0


def constraint_rows(motion: ChainMotion) -> ConstraintRows:
    """Return K J and -K A of all grasps (velocity rows)."""
    chain = motion.chain
    joint_rows, object_rows, slices, start = [], [], [], 0
    for name, c in zip(chain.grasps, motion.contacts, strict=True):
        arm = motion.arms[name]
        rows = np.zeros((len(c.K), chain.joint_count))
        rows[:, chain.joints[name]] = c.K @ jacobian(arm.arm, arm.at)
        joint_rows.append(rows)
        object_rows.append(-c.K @ twist_shift(c.offset))
        slices.append(slice(start, start + len(rows)))
        start += len(rows)
    if not slices:
        return ConstraintRows(np.zeros((0, chain.joint_count)), np.zeros((0, 6)), [])
    return ConstraintRows(np.concatenate(joint_rows), np.concatenate(object_rows), slices)
