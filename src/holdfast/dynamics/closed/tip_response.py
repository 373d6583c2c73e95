"""The tip response of one arm, and the back-substitution from the grasp force to its joints.

    tip response:       Lambda = J M^-1 J^T  and  alpha_f = J M^-1 T' + Jdot qd   (4.1), (6.8)
    back-substitution:  qdd = M^-1 (T' - J^T f)                                   (6.14)

Two routes give the same result: `recursive` in O(N), and `mass_matrix` in O(N^3), which needs fewer operations for
short arms.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import reduce
from typing import Literal, NamedTuple

import numpy as np

from holdfast.dynamics.arm.articulated import articulated_filter, smooth, tip_mobility, whiten
from holdfast.dynamics.arm.bias import bias_torque
from holdfast.dynamics.arm.forward_kinematics import jacobian
from holdfast.dynamics.arm.mass_matrix import mass_matrix
from holdfast.dynamics.arm.motion import ArmMotion
from holdfast.spatial.inertia import NO_INERTIA, RigidInertia
from holdfast.spatial.linalg import back_substitution, forward_substitution, root_free_cholesky
from holdfast.spatial.scalar import Array, array, concatenate, maximum, minimum, reciprocal, where
from holdfast.spatial.spatial_vector import rotate, shift_twist, shift_wrench, unrotate
from holdfast.spatial.symmetric import Symmetric6, symmetric6, zero6

Route = Literal["recursive", "mass_matrix", "auto"]

# Number of joints from which the recursion is cheaper, see docs/operation_counts.md (make counts).
RECURSION_PAYS_FROM = 18

LEAST_INERTIA = 1e-14  # articulated inertias smaller than this, relative to the arm's largest, are rounding


class BaseResponse(NamedTuple):
    """The response of one arm to an additional acceleration S beta of its base on a trunk, in world axes.

        alpha_tip = alpha_f + X beta - Lambda f,    S^T w_base = S^T (w_0 + I S beta) + w + Y beta + X^T f

    S are the arm's `base_columns`, and I is its inertia with locked joints.

    Attributes:
        X: (6, c) acceleration of the tip point per beta.
        Y: (c, c) contribution of the free joints to the inertia of the columns.
        wrench: (c,) contribution w of the free joints to the load of the columns, for beta = 0 and f = 0.
        locked: I about the base origin.
        at_rest: (6,) wrench w_0 of the base on the arm about the base origin, with locked joints and beta = 0.
    """

    X: Array
    Y: Array
    wrench: Array
    locked: RigidInertia
    at_rest: Array


@dataclass(frozen=True, eq=False)
class TipResponse:
    """The response of one arm at its tip, in world axes about the tip point.

    Attributes:
        mobility: Lambda(0).
        free_acceleration: (6,) alpha_f(0) minus [0; g].
        pivots: (N,) D; positive for a regular mass matrix.
        back_substitute: function of f (6,) and beta (c,) or None that returns qdd (N,) and the base wrench (6,) about
            the base origin, world axes.
        length: length of the fully extended arm, an upper bound of its levers [m].
        base: response at its base; None unless the arm is mounted on a trunk.
        for_load: function of a motion with the same configuration and other torques and wrenches that returns its tip
            response, using the same factors.
    """

    mobility: Symmetric6
    free_acceleration: Array
    pivots: Array
    back_substitute: Callable[..., tuple[Array, Array]]
    length: float
    base: BaseResponse | None = None
    for_load: Callable[[ArmMotion], TipResponse] | None = None


def tip_response(motion: ArmMotion, route: Route) -> TipResponse:
    """Return the arm's tip response by the chosen route."""
    if not motion.arm.joints:
        return prescribed(motion)
    if route == "auto":
        route = "recursive" if motion.arm.joint_count >= RECURSION_PAYS_FROM else "mass_matrix"
    return recursive(motion) if route == "recursive" else by_mass_matrix(motion)


def prescribed(motion: ArmMotion) -> TipResponse:
    """Return the tip response of an anchor, which moves with its base: Lambda = 0, and the base carries -f. O(1)."""
    reach, none, of_base = motion.base_to_tip, np.zeros(0), motion.bias.of_base
    known = np.zeros(6) if of_base is None else rotate(motion.arm.base.R, of_base)
    S, base = motion.base_columns, None
    if S is not None:
        count = S.shape[1]
        at_tip = array([shift_twist(reach, column) for column in S.T]).T
        base = BaseResponse(at_tip, np.zeros((count, count)), np.zeros(count), NO_INERTIA, known)

    def back_substitute(f: Array, beta: Array | None = None) -> tuple[Array, Array]:
        return none, known + shift_wrench(reach, f)

    acceleration, length = motion.bias.tip_acceleration, motion.arm.length
    return TipResponse(zero6(), acceleration, none, back_substitute, length, base, prescribed)


def recursive(motion: ArmMotion) -> TipResponse:
    """Return the tip response by filtering and smoothing: (5.14), (6.10), then (6.17). O(N)."""
    arm, at = motion.arm, motion.at
    filter = articulated_filter(arm, at)
    R, base_R = at.end, arm.base.R
    mobility = tip_mobility(arm, at, filter).rotated(R)
    S, X, Y = motion.base_columns, None, None
    base_inertia = None if S is None else filter.at_base.rotated(base_R)
    if S is not None and base_inertia is not None:
        still = np.zeros(arm.joint_count)
        X = array([rotate(R, smooth(arm, at, filter, still, unrotate(base_R, column))[1]) for column in S.T]).T
        Y = array([base_inertia.apply(column) for column in S.T]) @ S

    def response(motion: ArmMotion) -> TipResponse:
        eps, at_base = whiten(arm, at, filter, motion.torque, motion.bias.wrenches, None)
        _, tip = smooth(arm, at, filter, eps / filter.D)
        base = None
        if S is not None and X is not None and Y is not None:
            base = BaseResponse(X, Y, rotate(base_R, at_base) @ S, NO_INERTIA, np.zeros(6))

        def back_substitute(f: Array, beta: Array | None = None) -> tuple[Array, Array]:
            from_wrench, base_from_wrench = whiten(arm, at, filter, None, None, unrotate(R, f))
            under = None if beta is None or S is None else S @ beta
            moving = None if under is None else unrotate(base_R, under)
            qdd, _ = smooth(arm, at, filter, (eps + from_wrench) / filter.D, moving)
            wrench = rotate(base_R, at_base + base_from_wrench)
            return qdd, wrench if base_inertia is None or under is None else wrench + base_inertia.apply(under)

        free = rotate(R, tip) + motion.bias.tip_acceleration
        return TipResponse(mobility, free, filter.D, back_substitute, arm.length, base)

    return replace(response(motion), for_load=response)


def by_mass_matrix(motion: ArmMotion) -> TipResponse:
    """Return the tip response with M = L D L^T, X = L^-1 J^T: Lambda = X^T D^-1 X. O(N^3).

    With the torques B^T S that accelerations of the trunk's columns need, and Bh = L^-1 B^T S, the response at the base
    is phi^T S - X^T D^-1 Bh, -Bh^T D^-1 Bh and Bh^T D^-1 L^-1 (T - C).
    """
    arm, at = motion.arm, motion.at
    J = jacobian(arm, at)
    M, per_joint, locked = mass_matrix(arm, at)
    L, pivots = root_free_cholesky(M)
    inverse, X = reciprocal(pivots), forward_substitution(L, J.T)
    XD = X.T * inverse
    mobility = symmetric6(XD @ X)
    S, B, first = motion.base_columns, None, arm.base.R @ at.l[0]
    if S is not None:
        B = forward_substitution(L, per_joint.T @ first_columns(motion, S))

    def response(motion: ArmMotion) -> TipResponse:
        C, at_rest = bias_torque(arm, at, motion.bias.wrenches)
        x = forward_substitution(L, motion.torque - C)
        base = None
        if S is not None and B is not None:
            at_tip = array([shift_twist(motion.base_to_tip, column) for column in S.T]).T
            of_base = shift_wrench(first, rotate(at.R[0], at_rest))
            BD = B.T * inverse
            base = BaseResponse(at_tip - XD @ B, -(BD @ B), BD @ x, locked.moved(arm.base.R, np.zeros(3)), of_base)

        def back_substitute(f: Array, beta: Array | None = None) -> tuple[Array, Array]:
            free = x if B is None or beta is None else x - B @ beta
            qdd = back_substitution(L, inverse * (free - X @ f))
            at_first = rotate(at.R[0], at_rest + per_joint @ qdd) + shift_wrench(at.reach[0], f)
            wrench = shift_wrench(first, at_first)
            return qdd, wrench if base is None or S is None or beta is None else wrench + base.locked.apply(S @ beta)

        free = XD @ x + motion.bias.tip_acceleration
        return TipResponse(mobility, free, pivots, back_substitute, arm.length, base)

    return replace(response(motion), for_load=response)


def first_columns(motion: ArmMotion, columns: Array) -> Array:
    """Return columns of base accelerations, shifted to the first link's origin and in its axes, (6, c)."""
    at = motion.at
    first = motion.arm.base.R @ at.l[0]
    return array([unrotate(at.R[0], shift_twist(first, column)) for column in columns.T]).T


def responded(tip: TipResponse, f: Array, beta: Array | None = None) -> tuple[Array, Array]:
    """Return qdd (N,) and the base's wrench on the arm for a wrench f of the arm on the object.

    The accelerations are NaN if the arm's mass matrix is singular.

    Args:
        tip: the arm's tip response.
        f: (6,) wrench.
        beta: (c,) accelerations of the trunk's columns; None without a trunk.
    """
    qdd, base = tip.back_substitute(f, beta)
    return (if_regular(qdd, tip.pivots) if len(qdd) else qdd), base


def if_regular(qdd: Array, pivots: Array) -> Array:
    """Return joint accelerations, or NaN if the mass matrix with these pivots is singular, (N,)."""
    smallest, largest = reduce(minimum, pivots), reduce(maximum, pivots, 0.0)
    first = where(smallest > LEAST_INERTIA * largest, qdd[0], float("nan"))
    return concatenate([[first], qdd[1:]])
