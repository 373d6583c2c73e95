"""What each arm adds to an object whose acceleration is given: its forces and null motions as columns of their own.

With the acceleration of its contact given, an arm's accelerations are qdd = q0 + N y with K J N = 0, and with
x = (y, lambda)

    tau = T x + t,             T = [M N, (K J)^T],    t = M q0 + C + passive torques
    sum_i E_i x_i = e,         E = [0, A^T K^T],      e = M(C) (alpha - [0; g]) + b(C) - w

q0, the smallest, and N come from one Householder QR of (K J)^T. O(N) for each arm, N^2 for its mass matrix.

If accelerations of a trunk or of the object are unknown as well, q0 is affine in them, by the same factors, and so are
the torques. They are further columns, which the arms share.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.forward_kinematics import jacobian
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.arm.motion import ArmMotion
from holdfast.dynamics.arm.newton_euler import drive_torques
from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.trunk.whole_chain import on_base
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, less_equal, maximum, reciprocal, sqrt, where
from holdfast.spatial.spatial_vector import shift_twist, shift_wrench
from holdfast.spatial.vector import largest, outer

LOST = 1e-9  # a diagonal entry of R, relative to the largest row of K J, that counts as zero


class BlockColumn(NamedTuple):
    """An arm's columns, for forces in units of `force` and `force` times `length`, and null motions in units of 10.

    Attributes:
        T: (N, n + shared) [N m or N].
        t: (N,) torques of the arm's motion without grasp force, null motion and shared unknowns.
        E: (6, n) wrench on the object about C, world axes [N m, N].
        q0: (N,) smallest joint accelerations that follow the contact.
        null: (N, k) N, in units of 10 rad/s^2 or m/s^2.
        by_shared: (N, shared) changes of q0.
        units: (rows,) of the transmitted components lambda [N m or N].
        missed: (rows,) accelerations of the contact that the arm cannot follow, in m/s^2; 0 where it can.
        missed_by: (rows, shared) changes of these.
        stuck: (r, shared + 1) combinations of them that no joint moves, of an arm with fewer joints than rows; the last
            column is that without shared unknowns.
        on_base: (6, n + shared + 1) wrench of the base on a mounted arm about the base's origin, world axes; the last
            column is that without the others. (0, ..) for a base in the world.
    """

    T: Array
    t: Array
    E: Array
    q0: Array
    null: Array
    by_shared: Array
    units: Array
    missed: Array
    missed_by: Array
    stuck: Array
    on_base: Array


NULL_UNIT = 10.0  # of null motions [rad/s^2 or m/s^2]


def block_column(
    motion: ArmMotion,
    held: Contact | None,
    under: Array,
    alpha: Array,
    by_shared: Array,
    length: Scalar,
    force: Scalar,
    holds: bool = False,
) -> BlockColumn:
    """Return the columns of one arm.

    Args:
        motion: its motion.
        held: its grasp; None if it holds nothing.
        under: (6, shared + 1) acceleration of a mounted base per shared unknown, and last the one without them, in
            addition to that in `motion`, world axes; (0, ..) for a base in the world.
        alpha: (6,) acceleration of C minus [0; g], world axes.
        by_shared: (6, shared) changes of it.
        length: unit of length of the grasps [m].
        force: unit of force [N].
        holds: whether directions that the arm all but lost are held rather than left out.
    """
    N, none, mounted = motion.arm.joint_count, np.zeros(6), len(under) > 0
    s, rows = by_shared.shape[1], 0 if held is None else len(held.rows)
    q0, null, units, missed = np.zeros(N), np.eye(N), np.zeros(0), np.zeros(0)
    more, missed_by, stuck = np.zeros((N, s)), np.zeros((0, s)), np.zeros((0, s + 1))
    felt, E, loads = np.zeros((N, 0)), np.zeros((6, N)), np.zeros((6, 0))
    if held is not None and rows:
        J = jacobian(motion.arm, motion.at)
        scales = array(held.grasp.of_kind.row_scales(length))
        K = held.K
        wanted = shift_twist(held.offset, alpha) + held.a - held.g - motion.bias.tip_acceleration
        felt = (K @ J).T * scales
        if mounted:
            wanted = wanted - shift_twist(motion.base_to_tip, under[:, s])
        follower = follower_of(felt, holds)
        b = (K @ wanted) * scales
        q0, null = follower.smallest(b), follower.null
        missed = felt.T @ q0 - b
        if s:
            tips = [shift_twist(held.offset, column) for column in by_shared.T]
            if mounted:
                tips = [x - shift_twist(motion.base_to_tip, y) for x, y in zip(tips, under.T[:s], strict=True)]
            changes = [(K @ x) * scales for x in tips]
            found = [follower.smallest(x) for x in changes]
            more = array(found).reshape(s, N).T
            missed_by = array([felt.T @ q - x for q, x in zip(found, changes, strict=True)]).T
            stuck = array([follower.stuck(x) for x in (*changes, b)]).T
        units, felt = force * scales, force * felt
        pushes = array([shift_wrench(held.offset, row) for row in K]).T * units
        E = np.concatenate([np.zeros((6, null.shape[1])), pushes], 1)
        loads = array([shift_wrench(motion.base_to_tip, row) for row in K]).T * units if mounted else loads
    null = NULL_UNIT * null
    M, *_ = mass_matrix(motion.arm, motion.at)
    t = drive_torques(motion, np.zeros(N), none)[0] + M @ q0
    of_shared, base = M @ more, np.zeros((0, E.shape[1] + s + 1))
    if mounted:
        B, inertia, w = on_base(motion)
        of_shared, t = of_shared + B.T @ under[:, :s], t + B.T @ under[:, s]
        by_base = inertia @ under
        base = [B @ null, loads, B @ more + by_base[:, :s], (w + B @ q0 + by_base[:, s])[:, None]]
        base = np.concatenate(base, 1)
    T = np.concatenate([M @ null, felt, of_shared], 1)
    return BlockColumn(T, t, E, q0, null, more, units, missed, missed_by, stuck, base)


class Follower(NamedTuple):
    """The factors with which an arm's joints follow accelerations of its contact.

    Rows that all but depend on others are left out, so that the numbers are bounded at singular postures. If they are
    held instead, accelerations along them take 1 / `LOST` times as large ones of joints, so they cost more than others.

    Attributes:
        rows, joints: number of accelerations and of joints.
        reflections: those of Q, (K J)^T = Q R, or K J = Q R if there are more rows than joints.
        R: upper triangular.
        inverse: of its diagonal; 0 for what is left out, and that of the smallest entry for what is held.
    """

    rows: int
    joints: int
    reflections: list[tuple[Array, Scalar]]
    R: Array
    inverse: list[Scalar]

    @property
    def null(self) -> Array:
        """Orthonormal N with K J N = 0, (joints, max(joints - rows, 0))."""
        null = [reflected(self.reflections, unit) for unit in np.eye(self.joints)[self.rows :]]
        return array(null).reshape(len(null), self.joints).T

    def smallest(self, wanted: Array) -> Array:
        """Return the smallest q0 with K J q0 = wanted, (joints,); with too few joints, the least-squares solution."""
        N, rows, R, inverse = self.joints, self.rows, self.R, self.inverse
        if rows <= N:
            w: list[Scalar] = []
            for k in range(rows):
                w.append((wanted[k] - sum((R[j, k] * w[j] for j in range(k)), start=0.0)) * inverse[k])
            return reflected(self.reflections, concatenate([w, np.zeros(N - rows)]))
        b = self._turned(wanted)
        solved: list[Scalar] = []
        for k in reversed(range(N)):
            known = sum((R[k, j] * solved[N - 1 - j] for j in range(k + 1, N)), start=0.0)
            solved.append((b[k] - known) * inverse[k])
        return array(solved[::-1])

    def stuck(self, wanted: Array) -> Array:
        """Return the combinations of accelerations that no joint moves, (max(rows - joints, 0),)."""
        return self._turned(wanted)[self.joints :] if self.rows > self.joints else np.zeros(0)

    def _turned(self, b: Array) -> Array:
        """Return Q^T b."""
        for j, (v, factor) in enumerate(self.reflections):
            b = concatenate([b[:j], b[j:] - (factor * (v @ b[j:])) * v])
        return b


def follower_of(felt: Array, holds: bool = False) -> Follower:
    """Return the factors for an arm with (K J)^T = felt, (joints, rows); rows that are lost are held if it `holds`."""
    N, rows = felt.shape
    tall = felt if rows <= N else felt.T
    reflections, R = householder(tall)
    size = concatenate([np.zeros(1), [x @ x for x in tall.T]])
    bound = LOST * sqrt(largest(size))
    lost = reciprocal(maximum(bound, 1e-300)) if holds else 0.0
    inverse = [where(less_equal(abs(R[k, k]), bound), lost, reciprocal(R[k, k])) for k in range(len(R))]
    return Follower(rows, N, reflections, R, inverse)


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
