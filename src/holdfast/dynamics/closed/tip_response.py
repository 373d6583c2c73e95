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
from holdfast.spatial.linalg import back_substitution, cholesky, forward_substitution
from holdfast.spatial.scalar import Array, Scalar, concatenate, maximum, where
from holdfast.spatial.spatial_vector import rotate, shift_wrench, unrotate
from holdfast.spatial.symmetric import Symmetric6, symmetric6

Route = Literal["recursive", "mass_matrix", "auto"]

# docs/operation_counts.md (make counts): the recursion is cheaper from here on.
RECURSION_PAYS_FROM = 18

NO_INERTIA = 1e-14  # of the arm's largest articulated inertia: what is left is rounding


class TipResponse(NamedTuple):
    """How one arm answers at its tip, world axes about the tip point.

    Attributes:
        mobility: Lambda(0).
        free_acceleration: (6,) alpha_f(0), less [0; g].
        pivots: (N,) positive for a proper arm: D, or the squared Cholesky diagonal.
        back_substitute: f (6,) -> (qdd (N,), base wrench (6,) about the base origin, world axes).
        length: of the arm stretched out, which levers are sums of [m].
    """

    mobility: Symmetric6
    free_acceleration: Array
    pivots: Array
    back_substitute: Callable[[Array], tuple[Array, Array]]
    length: float


def tip_response(motion: ArmMotion, route: Route) -> TipResponse:
    """Return the arm's answer at its tip by the chosen route."""
    if route == "auto":
        route = "recursive" if motion.arm.joint_count >= RECURSION_PAYS_FROM else "mass_matrix"
    return recursive(motion) if route == "recursive" else by_mass_matrix(motion)


def recursive(motion: ArmMotion) -> TipResponse:
    """Return the answer by filtering and smoothing: (5.14), (6.10), then (6.17). O(N)."""
    arm, at = motion.arm, motion.at
    filter = articulated_filter(arm, at)
    eps, at_base = whiten(arm, at, filter, motion.torque, motion.bias.wrenches, None)
    _, tip = smooth(arm, at, filter, eps / filter.D)
    R = at.R[-1]

    def back_substitute(f: Array) -> tuple[Array, Array]:
        from_wrench, base_from_wrench = whiten(arm, at, filter, None, None, unrotate(R, f))
        qdd, _ = smooth(arm, at, filter, (eps + from_wrench) / filter.D)
        return qdd, rotate(arm.base.R, at_base + base_from_wrench)

    mobility = tip_mobility(arm, at, filter).rotated(R)
    return TipResponse(mobility, rotate(R, tip) + motion.bias.tip_acceleration, filter.D, back_substitute, arm.length)


def by_mass_matrix(motion: ArmMotion) -> TipResponse:
    """Return the answer with M = L L^T, X = L^-1 J^T: Lambda = X^T X. O(N^3)."""
    arm, at = motion.arm, motion.at
    J = jacobian(arm, at)
    C, at_rest = bias_torque(arm, at, motion.bias.wrenches)
    M, per_joint = mass_matrix(arm, at)
    L = cholesky(M)
    X = forward_substitution(L, J.T)
    x = forward_substitution(L, motion.torque - C)

    def back_substitute(f: Array) -> tuple[Array, Array]:
        qdd = back_substitution(L, x - X @ f)
        at_first = rotate(at.R[0], at_rest + per_joint @ qdd) + shift_wrench(at.reach[0], f)
        return qdd, shift_wrench(arm.base.R @ at.l[0], at_first)

    pivots = np.diag(L) * np.diag(L)
    return TipResponse(symmetric6(X.T @ X), x @ X + motion.bias.tip_acceleration, pivots, back_substitute, arm.length)


def responded(tip: TipResponse, f: Array) -> tuple[Array, Array]:
    """Return qdd (N,) and the base's wrench on the arm under a wrench f of the arm on the object.

    The accelerations are not-a-number where the arm's mass matrix is singular.
    """
    qdd, base = tip.back_substitute(f)
    largest: Scalar = 0.0
    for pivot in tip.pivots:
        largest = maximum(largest, pivot)
    first = qdd[0]
    for pivot in tip.pivots:
        first = where(pivot > NO_INERTIA * largest, first, float("nan"))
    return concatenate([[first], qdd[1:]]), base
