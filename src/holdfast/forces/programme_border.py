"""What arms share in the elastic programme: accelerations of a trunk and of the object, and torques of the trunk.

With the accelerations u of a floating base, of the trunk's joints, and of the object beyond what is asked, the columns
of arms (`block_columns`) are joined by the rows

    sum E_i x_i - M(C) u_C = e                                   the object
    sum S_i^T F_i(x_i, u) + M_t u - [0; tau_t] = T_t             base and trunk, F_i the wrench of the base of arm i
    S u_C = 0                                                    what is asked of the object, unless it gives way
    what no joint of an arm moves = 0                            arms with fewer joints than rows

The torques tau_t have limits and costs like those of arms. The unknowns are y, u = start + units y: without limits and
grasp forces, y = 0 costs least, and one unit of each y costs about as much. So near singular postures, where small
accelerations of the object take large ones of joints, the numbers remain of a size.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion
from holdfast.dynamics.closed.stacked import block_diagonal
from holdfast.dynamics.trunk.whole_chain import of_trunk
from holdfast.forces.block_columns import NULL_UNIT, BlockColumn
from holdfast.forces.programme_block import Block
from holdfast.spatial.linalg import back_substitution, cholesky, forward_substitution
from holdfast.spatial.scalar import Array, Scalar, concatenate, reciprocal

SMALLEST_PIVOT = 1e-14  # relative to the trace; below, rounding has lost it


class Shared(NamedTuple):
    """The accelerations that all arms share: those of a floating base, of a trunk's joints, and of the object.

    Attributes:
        mounts: by arm, the acceleration of its base by those of base and joints, (6, k); (0, k) in the world.
        own: (k, shared + 1) those of base and joints by the shared unknowns, and last without them.
        object: (6, shared + 1) that of the object beyond what is asked, likewise.
        floating: 6 with a floating base, or 0.
        inertia: (k, k) mass matrix of the trunk alone.
        torque: (k,) its torques minus bias torques.
    """

    mounts: list[Array]
    own: Array
    object: Array
    floating: int
    inertia: Array
    torque: Array

    @property
    def size(self) -> int:
        """Number of the shared unknowns."""
        return self.own.shape[1] - 1

    @property
    def joints(self) -> int:
        """Number of the trunk's joints."""
        return len(self.own) - self.floating

    @property
    def under(self) -> list[Array]:
        """By arm, the acceleration of its base, (6, shared + 1); (0, shared + 1) in the world."""
        return [S @ self.own for S in self.mounts]

    def moved(self, start: Array, units: Array) -> Shared:
        """Return the same for unknowns y of which the present ones are start + units y."""
        own, of_object = (
            np.concatenate([A[:, :-1] @ units, (A[:, :-1] @ start + A[:, -1])[:, None]], 1)
            for A in (self.own, self.object)
        )
        return self._replace(own=own, object=of_object)


def shared_accelerations(motion: ChainMotion, free: bool) -> Shared:
    """Return the accelerations that arms share; those of the object are among them if it is `free`. O(n_t^2)."""
    (S, M, T), names = of_trunk(motion.trunk), motion.chain.names
    k, more = len(T), 6 if free else 0
    mounts = [S.get(name, np.zeros((0, k))) for name in names]
    of_object = np.concatenate([np.zeros((6, k)), np.eye(6, more + 1)], 1) if free else np.zeros((6, k + 1))
    return Shared(mounts, np.eye(k, k + more + 1), of_object, 6 if motion.chain.floats else 0, M, T)


class Demand(NamedTuple):
    """What is asked of trunk and object, in units of F0.

    Attributes:
        units: (joints,) unit of the trunk's torques [N m or N].
        effort: (joints,) largest torques.
        weight: (joints,) of squared torques.
        wished: (joints,) accelerations.
        ranges: (2, joints) lowest and highest accelerations, in units of F0; (2, 0) without limits.
        per_force: 1 / F0.
        slow: weight of squared accelerations.
        task: (r, 6) rows of what is asked of the object; none if nothing of it is free.
        task_weight: weight of the distance from it; None if it is asked exactly.
        dearer: factor of costs of torques in the start of the unknowns. With it, torques at their limits cost as much
            as an object that falls instead of doing what is asked.
    """

    units: Array
    effort: Array
    weight: Array
    wished: Array
    ranges: Array
    per_force: Scalar
    slow: Scalar
    task: Array
    task_weight: Scalar | None
    dearer: Scalar

    @property
    def exact(self) -> Array:
        """The rows that are asked exactly."""
        return self.task if self.task_weight is None else self.task[:0]


class JoinedRows(NamedTuple):
    """The coupling rows, sum of_arms x + by_shared u + by_drives tau_t = e, in units of F0.

    Attributes:
        of_arms: (rows, n) for every arm.
        by_shared: (rows, shared).
        by_drives: (rows, joints).
        e: (rows,).
    """

    of_arms: list[Array]
    by_shared: Array
    by_drives: Array
    e: Array


def joined_rows(
    motion: ChainMotion, shared: Shared, columns: Sequence[BlockColumn], asked: Demand, to_force: Array, needed: Array
) -> JoinedRows:
    """Return the coupling rows.

    Args:
        motion: the chain's motion.
        shared: what arms share.
        columns: the arms' columns.
        asked: what is asked of trunk and object.
        to_force: (6,) what makes a wrench newtons, in units of F0.
        needed: (6,) wrench that the object needs for what is asked, in units of F0.
    """
    s, k = shared.size, len(shared.own)
    per_unit = concatenate([to_force[: shared.floating], reciprocal(asked.units)])
    of_trunk, loads = shared.inertia @ shared.own, []
    of_trunk = np.concatenate([of_trunk[:, :s], (of_trunk[:, s] - shared.torque)[:, None]], 1)
    for column, S in zip(columns, shared.mounts, strict=True):
        own = column.E.shape[1]
        wrenches = S.T @ column.on_base if len(column.on_base) else np.zeros((k, own + s + 1))
        of_trunk = of_trunk + wrenches[:, own:]
        loads.append(per_unit[:, None] * wrenches[:, :own])
    stuck = np.concatenate([np.zeros((0, s + 1)), *(column.stuck for column in columns if s)])
    rest = (1.0 / NULL_UNIT) * np.concatenate([stuck, asked.exact @ shared.object])
    of_arms = [
        np.concatenate([(column.E.T * to_force).T, pulls, np.zeros((len(rest), pulls.shape[1]))])
        for column, pulls in zip(columns, loads, strict=True)
    ]
    drives = np.concatenate([np.zeros((6 + shared.floating, shared.joints)), -np.eye(shared.joints)])
    drives = np.concatenate([drives, np.zeros((len(rest), shared.joints))])
    if not s:
        return JoinedRows(of_arms, np.zeros((6, 0)), drives, needed)
    of_object = -to_force[:, None] * (motion.body.inertia.dense() @ shared.object)
    all_rows = np.concatenate([of_object, per_unit[:, None] * of_trunk, rest])
    e = concatenate([needed, np.zeros(k + len(rest))]) - all_rows[:, s]
    return JoinedRows(of_arms, all_rows[:, :s], drives, e)


def scaled(
    shared: Shared,
    columns: Sequence[BlockColumn],
    weights: Sequence[Array],
    wishes: Sequence[Array],
    asked: Demand,
    joined: JoinedRows,
) -> Shared:
    """Return the accelerations by unknowns of one size; see the module's docstring.

    Args:
        shared: the accelerations, by themselves.
        columns: the arms' columns.
        weights: (N,) of squared torques, of every arm.
        wishes: (N,) accelerations, of every arm.
        asked: what is asked of trunk and object.
        joined: the coupling rows.
    """
    s, (P, c) = shared.size, _own_cost(shared, asked)
    P, c = P + joined.by_shared.T @ joined.by_shared, c - joined.by_shared.T @ joined.e
    H, slope = np.zeros((s, s)), np.zeros(s)
    for column, weight, wish in zip(columns, weights, wishes, strict=True):
        T, follow = column.T[:, column.T.shape[1] - s :], column.by_shared
        H, slope = H + (T.T * weight) @ T, slope + T.T @ (weight * column.t)
        P, c = P + asked.slow * (follow.T @ follow), c + asked.slow * (follow.T @ (column.q0 - wish))
    near, one = (_factor(P + times * H) for times in (asked.dearer, 1.0))
    start = -back_substitution(near, forward_substitution(near, c + asked.dearer * slope))
    return shared.moved(start, back_substitution(one, np.eye(s)))


def _factor(H: Array) -> Array:
    """Return the Cholesky factor of a matrix that may have lost its smallest pivots in rounding."""
    return cholesky(H + SMALLEST_PIVOT * np.trace(H) * np.eye(len(H)))


def _own_cost(shared: Shared, asked: Demand) -> tuple[Array, Array]:
    """Return P (shared, shared) and c (shared,) of the cost of the trunk's accelerations and of the object's."""
    s, wished = shared.size, concatenate([np.zeros(shared.floating), asked.wished])
    moving, still = shared.own[:, :s], shared.own[:, s] - wished
    P, c = asked.slow * (moving.T @ moving), asked.slow * (moving.T @ still)
    if asked.task_weight is not None:
        rows = asked.task_weight * (asked.task @ shared.object)
        P, c = P + rows[:, :s].T @ rows[:, :s], c + rows[:, :s].T @ rows[:, s]
    return P, c


def border_block(shared: Shared, asked: Demand, joined: JoinedRows) -> Block:
    """Return the block of the trunk's torques and of the shared unknowns."""
    n, s, (P, c) = shared.joints, shared.size, _own_cost(shared, asked)
    P = block_diagonal([np.diag(asked.weight), P])
    R, low, high = [np.eye(n, n + s)], [-asked.effort], [asked.effort]
    if asked.ranges.shape[1]:
        of_joints = asked.per_force * shared.own[shared.floating :]
        R.append(np.concatenate([np.zeros((n, n)), of_joints[:, :s]], 1))
        low.append(asked.ranges[0] - of_joints[:, s])
        high.append(asked.ranges[1] - of_joints[:, s])
    E, c = np.concatenate([joined.by_drives, joined.by_shared], 1), concatenate([np.zeros(n), c])
    return Block(P, c, np.concatenate(R), concatenate(low), concatenate(high), (), E, s)
