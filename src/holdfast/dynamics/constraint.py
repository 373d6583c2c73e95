"""The grasp constraint on velocities: K_i J_i qd_i = K_i A_i V(C) for every arm i.

With a trunk, J_i also has columns for the trunk's joints. With the relative velocities W as unknowns the constraint
reads [J, -A, H^T] (qd, V(C), W) = base motion, with six rows per grasp; multiplying by K eliminates W, so that
rank[J, -A, H^T] = rank K[J, -A] + sum n_g.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.jacobian import jacobian
from holdfast.dynamics.closed.chain_motion import ChainMotion
from holdfast.model.closed_chain import TRUNK
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import twist_shift

DEPENDENT = 1e-9  # singular values below this fraction of the largest count as zero
SMALLEST_LENGTH = 1e-3  # m: shorter lengths are not used as a length scale


class ConstraintRows(NamedTuple):
    """The rows of K [J, -A], one block per grasp in order.

    Attributes:
        joints: (rows, n) columns of the joint velocities.
        object: (rows, 6) columns of the object's twist V(C).
        base: (rows, 6) columns of the twist of a floating base; (rows, 0) without one.
        slices: the rows of each grasp.
    """

    joints: Array
    object: Array
    base: Array
    slices: list[slice]

    @property
    def matrix(self) -> Array:
        """The whole matrix K [J, -A], (rows, n + 6), with six more columns for a floating base."""
        return np.hstack([self.joints, self.object, self.base])

    @property
    def motions(self) -> Array:
        """An orthonormal basis of the null space, which is that of the allowed velocities, (n + 6, m). O(n^3)."""
        matrix = self.matrix
        if not len(matrix):
            return np.eye(matrix.shape[1])
        _, sizes, Vt = np.linalg.svd(matrix)
        return Vt[int((sizes > DEPENDENT * sizes[0]).sum()) :].T


def coordinate_sizes(motion: ChainMotion) -> Array:
    """Return the unit of each joint coordinate and of the object's [rotation; translation], (n + 6,).

    The unit of an angle is 1 rad. The unit of a length is the longest reach of an arm, or the largest distance of a
    grasp from C if that is longer [m], so that no step, norm or rank depends on the user's unit of length. With a
    floating base the result is (n + 12,), with the base last.
    """
    reach = [r for arm in motion.arms.values() for r in arm.at.reach] + [c.offset for c in motion.contacts]
    if motion.trunk is not None:
        reach += [body.reach for body in motion.trunk.bodies]
    length = max((float(np.linalg.norm(r)) for r in reach), default=0.0)
    length = length if length > SMALLEST_LENGTH else 1.0
    joints = [1.0 if joint.turns else length for joint in motion.chain.all_joints]
    free_bodies = 2 if motion.chain.floats else 1
    return np.array([*joints, *free_bodies * [1.0, 1.0, 1.0, length, length, length]])


def length_scale(offsets: list[Array]) -> float:
    """Return L, the rms distance of the contact points from their centroid [m].

    L is 1 m for a single contact and for contacts that all lie at one point.
    """
    if len(offsets) < 2:
        return 1.0
    points = np.array(offsets)
    L = float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()))
    return L if L > SMALLEST_LENGTH else 1.0


def constraint_rows(motion: ChainMotion) -> ConstraintRows:
    """Return the velocity rows K J and -K A of all grasps."""
    chain, trunk = motion.chain, motion.trunk
    free = 6 if chain.floats else 0
    joint_rows, object_rows = [np.zeros((0, chain.joint_count))], [np.zeros((0, 6))]
    base_rows, slices, start = [np.zeros((0, free))], [], 0
    for name, c in zip(chain.grasps, motion.contacts, strict=True):
        arm = motion.arms[name]
        rows, base = np.zeros((len(c.K), chain.joint_count)), np.zeros((len(c.K), 0))
        rows[:, chain.joints[name]] = c.K @ jacobian(arm.arm, arm.at)
        if trunk is not None:
            by_trunk, by_base = trunk.jacobian(name, arm.base_to_tip)
            rows[:, chain.joints[TRUNK]], base = c.K @ by_trunk, c.K @ by_base
        joint_rows.append(rows)
        object_rows.append(-c.K @ twist_shift(c.offset))
        base_rows.append(base)
        slices.append(slice(start, start + len(rows)))
        start += len(rows)
    whole = [np.concatenate(rows) for rows in (joint_rows, object_rows, base_rows)]
    return ConstraintRows(whole[0], whole[1], whole[2], slices)
