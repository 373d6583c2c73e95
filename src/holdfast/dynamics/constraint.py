"""The grasp constraint on velocities, K_i J_i qd_i = K_i A_i V(C) for every arm i, and the grasp forces without effect.

With a trunk, J_i also has columns for the trunk's joints. With the relative velocities W as unknowns the constraint
reads [J, -A, H^T] (qd, V(C), W) = base motion, with six rows per grasp; multiplying by K eliminates W, so that
rank[J, -A, H^T] = rank K[J, -A] + sum n_g. If rows depend on others, some grasp forces have no effect on the motion, so
the motion does not determine them; the smallest possible forces are chosen.
"""

from __future__ import annotations

from functools import reduce
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.forward_kinematics import jacobian
from holdfast.dynamics.closed.chain_motion import ChainMotion
from holdfast.dynamics.closed.stacked import block_diagonal
from holdfast.spatial.scalar import Array, Scalar, array, maximum, sqrt, where
from holdfast.spatial.spatial_vector import twist_shift

NULL_SINGULAR_VALUE = 1e-9  # singular values below this fraction of the largest count as zero
SMALLEST_LENGTH = 1e-3  # m: shorter lengths are not used as a length scale
WORTH_A_WORD = 0.05  # smaller wrenches, relative to the largest of a pattern, are not mentioned


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
    def on_driven_base(self) -> ConstraintRows:
        """The rows for velocities with which a floating base stays where it is."""
        return self._replace(base=self.base[:, :0])

    @property
    def motions(self) -> Array:
        """An orthonormal basis of the null space, which is that of the allowed velocities, (n + 6, m). O(n^3)."""
        matrix = self.matrix
        if not len(matrix):
            return np.eye(matrix.shape[1])
        _, sizes, Vt = np.linalg.svd(matrix)
        return Vt[int((sizes > NULL_SINGULAR_VALUE * sizes[0]).sum()) :].T


def coordinate_sizes(motion: ChainMotion) -> Array:
    """Return the unit of each joint coordinate and of the object's [rotation; translation], (n + 6,).

    The unit of an angle is 1 rad. The unit of a length is the longest reach of an arm, or the largest distance of a
    grasp from C if that is longer [m], so that no step, norm or rank depends on the user's unit of length. With a
    floating base the result is (n + 12,), with the base last.
    """
    reach = [r for arm in motion.arms.values() for r in arm.at.reach] + [c.offset for c in motion.contacts]
    reach += [body.reach for body in motion.trunk.bodies]
    length = sqrt(reduce(maximum, [r @ r for r in reach], 0.0))
    length = where(length > SMALLEST_LENGTH, length, 1.0)
    joints = [1.0 if joint.turns else length for joint in motion.chain.all_joints]
    free_bodies = 2 if motion.chain.floats else 1
    return array([*joints, *free_bodies * [1.0, 1.0, 1.0, length, length, length]])


def length_scale(offsets: list[Array]) -> Scalar:
    """Return L, the rms distance of the contact points from their centroid [m].

    L is 1 m for a single contact and for contacts that all lie at one point.
    """
    if len(offsets) < 2:
        return 1.0
    points = array(offsets)
    apart = points - points.mean(axis=0)
    L = sqrt((apart * apart).sum(axis=1).mean())
    return where(L > SMALLEST_LENGTH, L, 1.0)


def constraint_rows(motion: ChainMotion) -> ConstraintRows:
    """Return the velocity rows K J and -K A of all grasps."""
    chain, trunk = motion.chain, motion.trunk
    free = 6 if chain.floats else 0
    joint_rows, object_rows = [np.zeros((0, chain.joint_count))], [np.zeros((0, 6))]
    base_rows, slices, start = [np.zeros((0, free))], [], 0
    for name, c in zip(chain.grasps, motion.contacts, strict=True):
        arm, K = motion.arms[name], c.K
        columns = {other: np.zeros((len(K), of.joint_count)) for other, of in chain.arms.items()}
        columns[name] = K @ jacobian(arm.arm, arm.at)
        below, base = (K @ x for x in trunk.jacobian(name, arm.base_to_tip))
        joint_rows.append(np.hstack([below, *columns.values()]))
        object_rows.append(-K @ twist_shift(c.offset))
        base_rows.append(base)
        slices.append(slice(start, start + len(K)))
        start += len(K)
    whole = [np.concatenate(rows) for rows in (joint_rows, object_rows, base_rows)]
    return ConstraintRows(whole[0], whole[1], whole[2], slices)


def dimensionless_rows(motion: ChainMotion) -> Array:
    """Return K [J, -A] with lengths in units of the reach of the arms, (rows, n + 6); see `coordinate_sizes`."""
    sizes = coordinate_sizes(motion)
    lengths = [sizes[-1] if row < 3 else 1.0 for c in motion.contacts for row in c.rows]
    return array(lengths)[:, None] * constraint_rows(motion).matrix * sizes


class WrenchDirections(NamedTuple):
    """Patterns of grasp wrenches, in order of decreasing effect on the joints and the object.

    Attributes:
        columns: (6l, rows) stacked wrenches f = K^T lambda about the contact points, world axes;
            orthonormal in the metric sum |moment / length|^2 + |force|^2.
        rank: number of patterns that have an effect; the others have none.
    """

    columns: Array
    rank: int


def wrench_directions(motion: ChainMotion, length: float, *, by_joints: bool = True) -> WrenchDirections:
    """Return the left singular vectors of K [J, -A], with moments divided by `length` [m].

    Args:
        motion: the chain's motion.
        length: length of the metric [m].
        by_joints: whether to include the columns K J of the joints. Without them, the patterns beyond the rank are the
            internal wrenches, A^T K^T lambda = 0.
    """
    rows = constraint_rows(motion)
    K = block_diagonal([c.K for c in motion.contacts])
    metric = np.tile(np.r_[np.full(3, 1 / length), np.ones(3)], len(motion.contacts))
    # angular unknowns are in units of 1/length, so that all entries are lengths
    scale = np.r_[np.full(3, 1.0), np.full(3, length)]
    used = slice(None if by_joints else 0)
    by_base = rows.base * scale if rows.base.size else rows.base
    matrix = np.hstack([rows.joints[:, used], rows.object * scale, by_base[:, used]])
    # each column (a joint) is scaled to unit length, so that the effect on a joint has no unit
    matrix = (K.T @ matrix) / metric[:, None]  # maps velocities to wrenches in metric units
    sizes = np.linalg.norm(matrix, axis=0)
    matrix = matrix[:, sizes > 0] / sizes[sizes > 0]
    basis, _ = np.linalg.qr((K * metric).T)  # transmitted wrenches in metric units
    U, s, _ = np.linalg.svd(basis.T @ matrix)
    rank = int((s > NULL_SINGULAR_VALUE * max(s.max(initial=0.0), 1e-300)).sum())
    return WrenchDirections((basis @ U) / metric[:, None], rank)


def free_wrenches(motion: ChainMotion, length: float, rank: int | None = None) -> Array:
    """Return a basis of the grasp wrenches without effect on any joint or on the object.

    ker (K Omega K^T) = {lambda: J^T K^T lambda = 0 and A^T K^T lambda = 0}, with moments
    divided by `length` [m].

    Args:
        motion: the chain's motion.
        length: length of the metric [m].
        rank: rank of the constraint, if known. It is needed if the grasps are slightly open, because then the effect of
            these wrenches is small but not zero.

    Returns:
        (6l, k): columns of `WrenchDirections`.
    """
    directions = wrench_directions(motion, length)
    freedoms = motion.chain.contact_freedom_count
    return directions.columns[:, directions.rank if rank is None else rank - freedoms :]


def pattern(motion: ChainMotion, wrenches: Array, length: float) -> str:
    """Return the description of a pattern of grasp wrenches, in world axes.

    Args:
        motion: the chain's motion.
        wrenches: (grasps, 6) about the contact points, world axes, scaled so that the largest is 1.
        length: length by which moments are divided [m].
    """
    parts = []
    metric = np.r_[np.full(3, 1 / length), np.ones(3)]
    for name, c, f in zip(motion.chain.grasps, motion.contacts, wrenches, strict=True):
        size = np.abs(f * metric)
        if size.max() < WORTH_A_WORD:
            continue
        kind = "force" if size[3:].max() >= size[:3].max() else "moment"
        axis = f[3:] if kind == "force" else f[:3]
        x, y, z = axis / np.linalg.norm(axis)
        parts.append(f"{kind} ({x:+.2f}, {y:+.2f}, {z:+.2f}) at '{name}' ({c.grasp.kind})")
    return " against ".join(parts) + " (world axes)"
