"""What each arm adds to an object whose acceleration is given: its forces and null motions as columns of their own.

With the acceleration of its contact given, an arm's accelerations are qdd = q0 + N y with K J N = 0, and with
x = (y, lambda)

    tau = T x + t,             T = [M N, (K J)^T],    t = M q0 + C + passive torques
    sum_i E_i x_i = e,         E = [0, A^T K^T],      e = M(C) (alpha - [0; g]) + b(C) - w

q0, the smallest, and N come from one Householder QR of (K J)^T. O(N) for each arm, N^2 for its mass matrix.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.forward_kinematics import jacobian
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.arm.motion import ArmMotion
from holdfast.dynamics.arm.newton_euler import drive_torques
from holdfast.dynamics.closed.contact import Contact
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, less_equal, maximum, reciprocal, sqrt, where
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench
from holdfast.spatial.vector import largest, outer

LOST = 1e-9  # a diagonal entry of R, relative to the largest row of K J, that counts as zero


class BlockColumn(NamedTuple):
    """An arm's columns, for forces in units of `force` and `force` times `length`, and null motions in units of 10.

    Attributes:
        T: (N, n) [N m or N].
        t: (N,) torques of the arm's motion without grasp force and null motion.
        E: (6, n) wrench on the object about C, world axes [N m, N].
        q0: (N,) smallest joint accelerations that follow the contact.
        null: (N, k) N, in units of 10 rad/s^2 or m/s^2.
        units: (rows,) of the transmitted components lambda [N m or N].
        missed: largest acceleration of the contact that the arm cannot follow, rows in m/s^2; 0 where it can.
    """

    T: Array
    t: Array
    E: Array
    q0: Array
    null: Array
    units: Array
    missed: Scalar


NULL_UNIT = 10.0  # of null motions [rad/s^2 or m/s^2]


def block_column(motion: ArmMotion, held: Contact | None, alpha: Array, length: Scalar, force: Scalar) -> BlockColumn:
    """Return the columns of one arm.

    Args:
        motion: its motion.
        held: its grasp; None if it holds nothing.
        alpha: (6,) acceleration of C minus [0; g], world axes.
        length: unit of length of the grasps [m].
        force: unit of force [N].
    """
    N, none = motion.arm.joint_count, np.zeros(6)
    rows = 0 if held is None else len(held.rows)
    q0, null, units, missed = np.zeros(N), np.eye(N), np.zeros(0), 0.0
    felt, E = np.zeros((N, 0)), np.zeros((6, N))
    if held is not None and rows:
        J = jacobian(motion.arm, motion.at)
        scales = array(held.grasp.of_kind.row_scales(length))
        K = held.K
        wanted = shift_twist(held.offset, alpha) + held.a - held.g - motion.bias.tip_acceleration
        felt = (K @ J).T * scales
        q0, null, missed = followed(felt, (K @ wanted) * scales)
        units, felt = force * scales, force * felt
        E = np.concatenate(
            [np.zeros((6, null.shape[1])), array([shift_wrench(held.offset, row) for row in K]).T * units], 1
        )
    null = NULL_UNIT * null
    M, *_ = mass_matrix(motion.arm, motion.at)
    t = drive_torques(motion, np.zeros(N), none) + M @ q0
    return BlockColumn(np.concatenate([M @ null, felt], 1), t, E, q0, null, units, missed)


def followed(felt: Array, wanted: Array) -> tuple[Array, Array, Scalar]:
    """Return the smallest q0 with felt' q0 = wanted, and orthonormal N with felt' N = 0.

    Rows that all but depend on others are left out, so that the numbers are bounded at singular postures. If there are
    fewer joints than rows, q0 is the least-squares solution.

    Args:
        felt: (N, rows) (K J)^T.
        wanted: (rows,).

    Returns:
        q0 (N,); N (N, max(N - rows, 0)); and the largest entry of felt' q0 - wanted.
    """
    N, rows = felt.shape
    if N == 0:
        return np.zeros(0), np.zeros((0, 0)), largest(wanted)
    tall = felt if rows <= N else felt.T
    reflections, R = householder(tall)
    size = concatenate([np.zeros(1), [x @ x for x in tall.T]])
    bound = LOST * sqrt(largest(size))
    inverse = [where(less_equal(abs(R[k, k]), bound), 0.0, reciprocal(R[k, k])) for k in range(len(R))]
    if rows <= N:
        w: list[Scalar] = []
        for k in range(rows):
            w.append((wanted[k] - sum((R[j, k] * w[j] for j in range(k)), start=0.0)) * inverse[k])
        q0 = reflected(reflections, concatenate([w, np.zeros(N - rows)]))
    else:
        b = wanted
        for j, (v, factor) in enumerate(reflections):
            b = concatenate([b[:j], b[j:] - (factor * (v @ b[j:])) * v])
        solved: list[Scalar] = []
        for k in reversed(range(N)):
            known = sum((R[k, j] * solved[N - 1 - j] for j in range(k + 1, N)), start=0.0)
            solved.append((b[k] - known) * inverse[k])
        q0 = array(solved[::-1])
    null = [reflected(reflections, unit) for unit in np.eye(N)[rows:]]
    return q0, array(null).reshape(-1, N).T, largest(felt.T @ q0 - wanted)


def householder(A: Array) -> tuple[list[tuple[Array, Scalar]], Array]:
    """Return the reflections 1 - factor v v^T that make A (m, n), m >= n, upper triangular, and R (n, n).

    The k-th vector v has m - k entries, which act on the rows from k on.
    """
    n = A.shape[1]
    rest, reflections, rows = A, [], []
    for k in range(n):
        x = rest[:, 0]
        size = sqrt(x @ x)
        signed = where(x[0] < 0.0, -size, size)
        v = concatenate([[x[0] + signed], x[1:]])
        square = size * (size + abs(x[0]))
        factor = where(square > 0.0, reciprocal(maximum(square, 1e-300)), 0.0)
        rest = rest[:, 1:] - outer(factor * v, v @ rest[:, 1:])
        rows.append(concatenate([np.zeros(k), [-signed], rest[0]]))
        reflections.append((v, factor))
        rest = rest[1:]
    return reflections, array(rows).reshape(n, n)


def reflected(reflections: list[tuple[Array, Scalar]], x: Array) -> Array:
    """Return Q x for the product Q of reflections."""
    for k, (v, factor) in reversed(list(enumerate(reflections))):
        x = concatenate([x[:k], x[k:] - (factor * (v @ x[k:])) * v])
    return x
