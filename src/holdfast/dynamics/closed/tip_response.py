"""The two stages of one arm around the object: outward to its tip, and back from the grasp force.

    outward:            Lambda = J M^-1 J^T  and  alpha_f = J M^-1 T' + Jdot qd   (4.1), (6.8)
    back-substitution:  qdd = M^-1 (T' - J^T f)                                   (6.14)

Two routes give the same numbers: `recursive`, O(N), and `mass_matrix`, O(N^3) but with
fewer operations on short arms.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np

from holdfast.dynamics.arm.articulated import articulated_filter, smooth, whiten
from holdfast.dynamics.arm.bias import bias_torque
from holdfast.dynamics.arm.jacobian import jacobian
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.arm.motion import ArmMotion
from holdfast.dynamics.arm.tip_mobility import tip_mobility
from holdfast.spatial.inertia import NO_INERTIA as NO_BODY
from holdfast.spatial.inertia import RigidInertia
from holdfast.spatial.linalg import back_substitution, cholesky, forward_substitution
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, maximum, where
from holdfast.spatial.spatial_vector import rotate, shift_twist, shift_wrench, unrotate
from holdfast.spatial.symmetric import Symmetric6, symmetric6, zero6

Route = Literal["recursive", "mass_matrix", "auto"]

# docs/operation_counts.md (make counts): the recursion is cheaper from here on.
RECURSION_PAYS_FROM = 18

NO_INERTIA = 1e-14  # of the arm's largest articulated inertia: what is left is rounding


class BaseResponse(NamedTuple):
    """How one arm answers at its base, which a trunk accelerates by S beta more than its motion says, world axes.

        alpha_tip = alpha_f + X beta - Lambda f,    S^T w_base = S^T (w_0 + I S beta) + w + Y beta + X^T f

    S are the arm's `base_columns`, I its inertia with the joints locked.

    Attributes:
        X: (6, c) from beta to the acceleration of the tip point.
        Y: (c, c) what free joints add to the inertia that the columns feel.
        wrench: (c,) what they add to the load, with beta and f zero.
        locked: I about the base origin.
        at_rest: (6,) w_0 of the base on the arm about the base origin, with its joints locked and beta zero.
    """

    X: Array
    Y: Array
    wrench: Array
    locked: RigidInertia
    at_rest: Array


class TipResponse(NamedTuple):
    """How one arm answers at its tip, world axes about the tip point.

    Attributes:
        mobility: Lambda(0).
        free_acceleration: (6,) alpha_f(0), less [0; g].
        pivots: (N,) positive for a proper arm: D, or the squared Cholesky diagonal.
        back_substitute: f (6,), beta (c,) or None -> (qdd (N,), base wrench (6,) about the base origin, world axes).
        length: of the arm stretched out, which levers are sums of [m].
        base: how it answers at its base; None unless it stands on a trunk.
        again: the same configuration under other torques and wrenches -> its answer, by the factors at hand.
    """

    mobility: Symmetric6
    free_acceleration: Array
    pivots: Array
    back_substitute: Callable[..., tuple[Array, Array]]
    length: float
    base: BaseResponse | None = None
    again: Callable[[ArmMotion], TipResponse] | None = None


def tip_response(motion: ArmMotion, route: Route) -> TipResponse:
    """Return the arm's answer at its tip by the chosen route."""
    if not motion.arm.joints:
        return prescribed(motion)
    if route == "auto":
        route = "recursive" if motion.arm.joint_count >= RECURSION_PAYS_FROM else "mass_matrix"
    return recursive(motion) if route == "recursive" else by_mass_matrix(motion)


def prescribed(motion: ArmMotion) -> TipResponse:
    """Return the answer of an anchor, which moves as its base does: Lambda = 0, and its base feels -f alone. O(1)."""
    reach, none, of_base = motion.base_to_tip, np.zeros(0), motion.bias.of_base
    known = np.zeros(6) if of_base is None else rotate(motion.arm.base.R, of_base)
    S, base = motion.base_columns, None
    if S is not None:
        count = S.shape[1]
        at_tip = array([shift_twist(reach, column) for column in S.T]).T
        base = BaseResponse(at_tip, np.zeros((count, count)), np.zeros(count), NO_BODY, known)

    def back_substitute(f: Array, beta: Array | None = None) -> tuple[Array, Array]:
        return none, known + shift_wrench(reach, f)

    acceleration, length = motion.bias.tip_acceleration, motion.arm.length
    return TipResponse(zero6(), acceleration, none, back_substitute, length, base, prescribed)


def recursive(motion: ArmMotion) -> TipResponse:
    """Return the answer by filtering and smoothing: (5.14), (6.10), then (6.17). O(N)."""
    arm, at = motion.arm, motion.at
    filter = articulated_filter(arm, at)
    R, base_R = at.end, arm.base.R
    mobility = tip_mobility(arm, at, filter).rotated(R)
    S, X, Y = motion.base_columns, None, None
    felt = None if S is None else filter.at_base.rotated(base_R)
    if S is not None and felt is not None:
        still = np.zeros(arm.joint_count)
        X = array([rotate(R, smooth(arm, at, filter, still, unrotate(base_R, column))[1]) for column in S.T]).T
        Y = array([felt.apply(column) for column in S.T]) @ S

    def answer(motion: ArmMotion) -> TipResponse:
        eps, at_base = whiten(arm, at, filter, motion.torque, motion.bias.wrenches, None)
        _, tip = smooth(arm, at, filter, eps / filter.D)
        base = None
        if S is not None and X is not None and Y is not None:
            base = BaseResponse(X, Y, rotate(base_R, at_base) @ S, NO_BODY, np.zeros(6))

        def back_substitute(f: Array, beta: Array | None = None) -> tuple[Array, Array]:
            from_wrench, base_from_wrench = whiten(arm, at, filter, None, None, unrotate(R, f))
            under = None if beta is None or S is None else S @ beta
            moving = None if under is None else unrotate(base_R, under)
            qdd, _ = smooth(arm, at, filter, (eps + from_wrench) / filter.D, moving)
            wrench = rotate(base_R, at_base + base_from_wrench)
            return qdd, wrench if felt is None or under is None else wrench + felt.apply(under)

        free = rotate(R, tip) + motion.bias.tip_acceleration
        return TipResponse(mobility, free, filter.D, back_substitute, arm.length, base)

    return answer(motion)._replace(again=answer)


def by_mass_matrix(motion: ArmMotion) -> TipResponse:
    """Return the answer with M = L L^T, X = L^-1 J^T: Lambda = X^T X. O(N^3).

    At the base, with B^T S the torques that the trunk's columns ask for and Bh = L^-1 B^T S: phi^T S - X^T Bh, -Bh^T Bh
    and Bh^T L^-1 (T - C).
    """
    arm, at = motion.arm, motion.at
    J = jacobian(arm, at)
    M, per_joint, locked = mass_matrix(arm, at)
    L = cholesky(M)
    X = forward_substitution(L, J.T)
    mobility, pivots = symmetric6(X.T @ X), np.diag(L) * np.diag(L)
    S, B, first = motion.base_columns, None, arm.base.R @ at.l[0]
    if S is not None:
        B = forward_substitution(L, per_joint.T @ first_columns(motion, S))

    def answer(motion: ArmMotion) -> TipResponse:
        C, at_rest = bias_torque(arm, at, motion.bias.wrenches)
        x = forward_substitution(L, motion.torque - C)
        base = None
        if S is not None and B is not None:
            at_tip = array([shift_twist(motion.base_to_tip, column) for column in S.T]).T
            of_base = shift_wrench(first, rotate(at.R[0], at_rest))
            base = BaseResponse(at_tip - X.T @ B, -(B.T @ B), x @ B, locked.moved(arm.base.R, np.zeros(3)), of_base)

        def back_substitute(f: Array, beta: Array | None = None) -> tuple[Array, Array]:
            free = x if B is None or beta is None else x - B @ beta
            qdd = back_substitution(L, free - X @ f)
            at_first = rotate(at.R[0], at_rest + per_joint @ qdd) + shift_wrench(at.reach[0], f)
            wrench = shift_wrench(first, at_first)
            return qdd, wrench if base is None or S is None or beta is None else wrench + base.locked.apply(S @ beta)

        free = x @ X + motion.bias.tip_acceleration
        return TipResponse(mobility, free, pivots, back_substitute, arm.length, base)

    return answer(motion)._replace(again=answer)


def first_columns(motion: ArmMotion, columns: Array) -> Array:
    """Return what columns of base accelerations are at the first link's origin, in its axes, (6, c)."""
    at = motion.at
    first = motion.arm.base.R @ at.l[0]
    return array([unrotate(at.R[0], shift_twist(first, column)) for column in columns.T]).T


def responded(tip: TipResponse, f: Array, beta: Array | None = None) -> tuple[Array, Array]:
    """Return qdd (N,) and the base's wrench on the arm under a wrench f of the arm on the object.

    The accelerations are not-a-number where the arm's mass matrix is singular.

    Args:
        tip: the arm's answer.
        f: (6,).
        beta: (c,) accelerations of the trunk's columns; None in the world.
    """
    qdd, base = tip.back_substitute(f, beta)
    if not len(qdd):
        return qdd, base
    largest: Scalar = 0.0
    for pivot in tip.pivots:
        largest = maximum(largest, pivot)
    first = qdd[0]
    for pivot in tip.pivots:
        first = where(pivot > NO_INERTIA * largest, first, float("nan"))
    return concatenate([[first], qdd[1:]]), base
