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
from holdfast.spatial.inertia import RigidInertia
from holdfast.spatial.linalg import back_substitution, cholesky, forward_substitution
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, maximum, where
from holdfast.spatial.spatial_vector import rotate, shift_wrench, twist_shift, unrotate
from holdfast.spatial.symmetric import Symmetric6, symmetric6, zero6

Route = Literal["recursive", "mass_matrix", "auto"]

# docs/operation_counts.md (make counts): the recursion is cheaper from here on.
RECURSION_PAYS_FROM = 18

NO_INERTIA = 1e-14  # of the arm's largest articulated inertia: what is left is rounding


class BaseResponse(NamedTuple):
    """How one arm answers at its base, which a trunk accelerates by beta more than its motion says, world axes.

        alpha_tip = alpha_f + X beta - Lambda f,    w_base = w_f + Y beta + X^T f

    Attributes:
        X: (6, 6) from beta at the base to the acceleration of the tip point.
        Y: inertia that the base feels while the joints are free.
        wrench: (6,) w_f of the base on the arm about the base origin, with beta and f zero.
    """

    X: Array
    Y: Symmetric6
    wrench: Array

    def seen_from(self, offset: Array) -> BaseResponse:
        """Return the same about another point of the body that carries the base, `offset` from there to it [m]."""
        X = array([shift_wrench(offset, row) for row in self.X])  # X phi^T
        return BaseResponse(X, self.Y.inertia_shifted(offset), shift_wrench(offset, self.wrench))


class TipResponse(NamedTuple):
    """How one arm answers at its tip, world axes about the tip point.

    Attributes:
        mobility: Lambda(0).
        free_acceleration: (6,) alpha_f(0), less [0; g].
        pivots: (N,) positive for a proper arm: D, or the squared Cholesky diagonal.
        back_substitute: f (6,), beta (6,) or None -> (qdd (N,), base wrench (6,) about the base origin, world axes).
        length: of the arm stretched out, which levers are sums of [m].
        base: how it answers at its base; None unless it stands on a trunk.
        again: the same posture under other torques and wrenches -> its answer, by the factors at hand.
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
    base = BaseResponse(twist_shift(reach), zero6(), known) if motion.mounted else None

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
    X = None
    if motion.mounted:
        still = np.zeros(arm.joint_count)
        X = array([rotate(R, smooth(arm, at, filter, still, unrotate(base_R, unit))[1]) for unit in np.eye(6)]).T

    def answer(motion: ArmMotion) -> TipResponse:
        eps, at_base = whiten(arm, at, filter, motion.torque, motion.bias.wrenches, None)
        _, tip = smooth(arm, at, filter, eps / filter.D)
        base = None if X is None else BaseResponse(X, filter.at_base.rotated(base_R), rotate(base_R, at_base))

        def back_substitute(f: Array, beta: Array | None = None) -> tuple[Array, Array]:
            from_wrench, base_from_wrench = whiten(arm, at, filter, None, None, unrotate(R, f))
            under = None if beta is None else unrotate(base_R, beta)
            qdd, _ = smooth(arm, at, filter, (eps + from_wrench) / filter.D, under)
            wrench = rotate(base_R, at_base + base_from_wrench)
            return qdd, wrench if base is None or beta is None else wrench + base.Y.apply(beta)

        free = rotate(R, tip) + motion.bias.tip_acceleration
        return TipResponse(mobility, free, filter.D, back_substitute, arm.length, base)

    return answer(motion)._replace(again=answer)


def by_mass_matrix(motion: ArmMotion) -> TipResponse:
    """Return the answer with M = L L^T, X = L^-1 J^T: Lambda = X^T X. O(N^3)."""
    arm, at = motion.arm, motion.at
    J = jacobian(arm, at)
    M, per_joint, locked = mass_matrix(arm, at)
    L = cholesky(M)
    X = forward_substitution(L, J.T)
    mobility, pivots = symmetric6(X.T @ X), np.diag(L) * np.diag(L)

    def answer(motion: ArmMotion) -> TipResponse:
        C, at_rest = bias_torque(arm, at, motion.bias.wrenches)
        x = forward_substitution(L, motion.torque - C)
        base = by_base(motion, L, X, x, at_rest, per_joint, locked) if motion.mounted else None

        def back_substitute(f: Array, beta: Array | None = None) -> tuple[Array, Array]:
            if base is None or beta is None:
                qdd = back_substitution(L, x - X @ f)
                at_first = rotate(at.R[0], at_rest + per_joint @ qdd) + shift_wrench(at.reach[0], f)
                return qdd, shift_wrench(arm.base.R @ at.l[0], at_first)
            qdd = back_substitution(L, x - base.B @ beta - X @ f)
            response = base.response
            return qdd, response.wrench + response.Y.apply(beta) + f @ response.X

        free = x @ X + motion.bias.tip_acceleration
        response = None if base is None else base.response
        return TipResponse(mobility, free, pivots, back_substitute, arm.length, response)

    return answer(motion)._replace(again=answer)


class WhitenedBase(NamedTuple):
    """What the mass matrix of a mounted arm leaves of its base.

    Attributes:
        B: (N, 6) L^-1 B^T, B beta the torques that an acceleration beta of the base asks for.
        response: how the arm answers there.
    """

    B: Array
    response: BaseResponse


def by_base(
    motion: ArmMotion, L: Array, X: Array, x: Array, at_rest: Array, per_joint: Array, locked: RigidInertia
) -> WhitenedBase:
    """Return the answer at the base: phi^T - X^T Bh, I - Bh^T Bh and w_0 + Bh^T x, with Bh = L^-1 B^T. O(N^2).

    Args:
        motion: the arm, on a trunk.
        L: of its mass matrix.
        X: (N, 6) L^-1 J^T.
        x: (N,) L^-1 (T - C).
        at_rest: (6,) wrench on the first link at qdd = 0, as `bias_torque` returns it.
        per_joint: (6, N) the same of unit joint accelerations, as `mass_matrix` returns it.
        locked: inertia of the arm, joints locked, as `mass_matrix` returns it.
    """
    arm, at = motion.arm, motion.at
    first = arm.base.R @ at.l[0]

    def at_base(wrench: Array) -> Array:
        return shift_wrench(first, rotate(at.R[0], wrench))

    B = forward_substitution(L, array([at_base(column) for column in per_joint.T]))
    rigid = locked.symmetric().rotated(arm.base.R).dense()
    response = BaseResponse(
        twist_shift(motion.base_to_tip) - X.T @ B, symmetric6(rigid - B.T @ B), at_base(at_rest) + x @ B
    )
    return WhitenedBase(B, response)


def responded(tip: TipResponse, f: Array, beta: Array | None = None) -> tuple[Array, Array]:
    """Return qdd (N,) and the base's wrench on the arm under a wrench f of the arm on the object.

    The accelerations are not-a-number where the arm's mass matrix is singular.

    Args:
        tip: the arm's answer.
        f: (6,).
        beta: (6,) what a trunk accelerates the base by more than its motion says; None in the world.
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
