"""What arms share in the elastic programme: accelerations of a trunk and of the object, and torques of the trunk.

With the accelerations u of a floating base, of the trunk's joints, and of the object beyond what is asked, the columns
of arms (`block_columns`) are joined by the rows

    sum E_i x_i - M(C) u_C = e                                   the object
    sum S_i^T F_i(x_i, u) + M_t u - [0; tau_t] = T_t             base and trunk, F_i the wrench of the base of arm i
    S u_C = 0                                                    what is asked of the object, unless it gives way
    what no joint of an arm moves = 0                            arms with fewer joints than rows

The torques tau_t have limits and costs like those of arms. u = start + units y: y = 0 costs least without limits where
arms exert no forces, and one unit of each y costs about as much. So near singular postures, where small accelerations
of the object take large ones of joints, the numbers remain of a size.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.closed.chain_motion import ChainMotion
from holdfast.dynamics.trunk.whole_chain import of_trunk
from holdfast.forces.block_columns import NULL_UNIT, BlockColumn
from holdfast.forces.programme_block import Block
from holdfast.spatial.linalg import back_substitution, cholesky, forward_substitution
from holdfast.spatial.scalar import Array, Scalar, concatenate, reciprocal


class Shared(NamedTuple):
    """The accelerations that all arms share: those of a floating base, of a trunk's joints, and of the object.

    Attributes:
        under: by arm, the acceleration of its base, (6, shared); (0, shared) in the world.
        object: (6, shared) acceleration of C.
        floating: 6 with a floating base, or 0.
        joints: number of the trunk's joints.
        inertia: (floating + joints,) * 2 mass matrix of the trunk alone.
        torque: (floating + joints,) its torques minus bias torques.
    """

    under: list[Array]
    object: Array
    floating: int
    joints: int
    inertia: Array
    torque: Array

    @property
    def count(self) -> int:
        """Number of these accelerations."""
        return self.object.shape[1]

    @property
    def of_trunk(self) -> int:
        """Number of those of base and joints, the first ones."""
        return self.floating + self.joints

    @property
    def of_joints(self) -> slice:
        """Place of those of the trunk's joints."""
        return slice(self.floating, self.of_trunk)


def shared_accelerations(motion: ChainMotion, free: bool) -> Shared:
    """Return the accelerations that arms share; those of the object are among them if it is `free`. O(n_t^2)."""
    trunk, names = motion.trunk, motion.chain.names
    M, T, S = np.zeros((0, 0)), np.zeros(0), {}
    if trunk is not None:
        S, M, T = of_trunk(trunk)
    first, of_object = len(T), 6 if free else 0
    beyond, none = np.zeros((6, of_object)), np.zeros((0, first + of_object))
    under = [np.concatenate([S[name], beyond], 1) if name in S else none for name in names]
    floating = 6 if motion.chain.floats else 0
    by_object = np.concatenate([np.zeros((6, first)), np.eye(6)[:, :of_object]], 1)
    return Shared(under, by_object, floating, first - floating, M, T)


class Asked(NamedTuple):
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


class SharedUnits(NamedTuple):
    """The accelerations u = start + units y; see the module's docstring."""

    start: Array
    units: Array


def joined_rows(
    motion: ChainMotion, shared: Shared, columns: Sequence[BlockColumn], asked: Asked, to_force: Array, needed: Array
) -> JoinedRows:
    """Return the coupling rows.

    Args:
        motion: the chain's motion.
        shared: what arms share.
        columns: the arms' columns.
        asked: what is asked of trunk and object.
        to_force: (6,) what makes a wrench newtons, in units of F0.
        needed: (6,) wrench that the object needs, in units of F0.
    """
    s, n_t = shared.count, shared.of_trunk
    per_unit = concatenate([to_force[: shared.floating], reciprocal(asked.units)])
    of_trunk = np.concatenate([per_unit[:, None] * shared.inertia, np.zeros((n_t, s - n_t))], 1)
    at_rest, loads = per_unit * shared.torque, []
    for column, under in zip(columns, shared.under, strict=True):
        own = column.E.shape[1]
        pulls = np.zeros((n_t, own))
        if len(column.on_base):
            wrenches = per_unit[:, None] * (under.T[:n_t] @ column.on_base)
            pulls, at_rest = wrenches[:, :own], at_rest - wrenches[:, -1]
            of_trunk = of_trunk + wrenches[:, own:-1]
        loads.append(pulls)
    stuck = np.concatenate([np.zeros((0, s + 1)), *((1.0 / NULL_UNIT) * column.stuck for column in columns if s)])
    task = (1.0 / NULL_UNIT) * (asked.exact @ shared.object)
    rest = len(stuck) + len(task)
    of_arms = [
        np.concatenate([(column.E.T * to_force).T, pulls, np.zeros((rest, pulls.shape[1]))])
        for column, pulls in zip(columns, loads, strict=True)
    ]
    of_object = -to_force[:, None] * (motion.body.inertia.dense() @ shared.object)
    drives = np.concatenate([np.zeros((6 + shared.floating, shared.joints)), -np.eye(shared.joints)])
    return JoinedRows(
        of_arms,
        np.concatenate([of_object, of_trunk, stuck[:, :s], task]),
        np.concatenate([drives, np.zeros((rest, shared.joints))]),
        concatenate([needed, at_rest, -stuck[:, s], np.zeros(len(task))]),
    )


def shared_units(
    shared: Shared,
    columns: Sequence[BlockColumn],
    weights: Sequence[Array],
    wishes: Sequence[Array],
    asked: Asked,
    joined: JoinedRows,
) -> SharedUnits:
    """Return start and units of the shared accelerations.

    Args:
        shared: what arms share.
        columns: the arms' columns.
        weights: (N,) of squared torques, of every arm.
        wishes: (N,) accelerations, of every arm.
        asked: what is asked of trunk and object.
        joined: the coupling rows.
    """
    s, n_t, slow = shared.count, shared.of_trunk, asked.slow
    H = joined.by_shared.T @ joined.by_shared + slow * np.diag([*[1.0] * n_t, *[0.0] * (s - n_t)])
    slope = -(joined.by_shared.T @ joined.e)
    for column, weight, wish in zip(columns, weights, wishes, strict=True):
        first = column.T.shape[1] - s
        T, follow = column.T[:, first:], column.by_shared
        H = H + (T.T * weight) @ T + slow * (follow.T @ follow)
        slope = slope + T.T @ (weight * column.t) + slow * (follow.T @ (column.q0 - wish))
    if asked.task_weight is not None:
        rows = asked.task_weight * (asked.task @ shared.object)
        H = H + rows.T @ rows
    slope = slope - slow * concatenate([np.zeros(shared.floating), asked.wished, np.zeros(s - n_t)])
    C = cholesky(H)
    return SharedUnits(
        -back_substitution(C, forward_substitution(C, slope)), back_substitution(C, np.eye(s)),
    )


def border_block(shared: Shared, at: SharedUnits, asked: Asked, joined: JoinedRows) -> Block:
    """Return the block of the trunk's torques and of the shared accelerations."""
    n, s, k = shared.joints, shared.count, shared.of_trunk
    moving, still = at.units[:k], at.start[:k]
    wished = concatenate([np.zeros(shared.floating), asked.wished])
    P, c = asked.slow * (moving.T @ moving), asked.slow * (moving.T @ (still - wished))
    if asked.task_weight is not None:
        rows = asked.task_weight * (asked.task @ shared.object)
        missed = rows @ at.units
        P, c = P + missed.T @ missed, c + missed.T @ (rows @ at.start)
    of_drives = np.concatenate([np.diag(asked.weight).reshape(n, n), np.zeros((n, s))], 1)
    P = np.concatenate([of_drives, np.concatenate([np.zeros((s, n)), P], 1)])
    R, low, high = [np.eye(n, n + s)], [-asked.effort], [asked.effort]
    if asked.ranges.shape[1]:
        joints = shared.of_joints
        R.append(np.concatenate([np.zeros((n, n)), asked.per_force * at.units[joints]], 1))
        low.append(asked.ranges[0] - asked.per_force * at.start[joints])
        high.append(asked.ranges[1] - asked.per_force * at.start[joints])
    E = np.concatenate([joined.by_drives, joined.by_shared @ at.units], 1)
    c = concatenate([np.zeros(n), c])
    return Block(P, c, np.concatenate(R), concatenate(low), concatenate(high), (), E, s)
