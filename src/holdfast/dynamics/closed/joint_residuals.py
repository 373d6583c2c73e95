"""Derivatives of an arm's equations with respect to all of its joints, computed together.

The derivatives of the torques and of the tip's motion come from `arm.joint_slopes`; those of the grasp's part follow
from linearising its virtual power in the tip's motion. The results equal those of `ArmCase.residual`, with a fifth of
the operations.
"""

from __future__ import annotations

import numpy as np

from holdfast.dynamics.arm.bias import acceleration_at_tip, bias_accelerations
from holdfast.dynamics.arm.forward_kinematics import forward_kinematics
from holdfast.dynamics.arm.joint_slopes import JointSlope, joint_slopes
from holdfast.dynamics.arm.velocity import link_twists, tip_twist
from holdfast.dynamics.closed.virtual_power import ArmCase, TipMotion, Unknowns
from holdfast.spatial.differentiation import gradient, linearised
from holdfast.spatial.linear import Linear
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, array
from holdfast.spatial.spatial_vector import shift_wrench
from holdfast.spatial.vector import skew


def joint_residuals(case: ArmCase, z: Unknowns) -> dict[str, list[Unknowns]]:
    """Return the derivatives of dL/dy by each joint's position (`q`) and rate (`qd`) for constant z; O(N^2) in total.

    Args:
        case: arguments of the arm's equations.
        z: the solution.
    """
    given, arm = case.given, case.given.arm
    at = forward_kinematics(arm, given.q)
    V = link_twists(arm, at, given.qd, given.base_twist)
    base = given.base_twist, given.base_acceleration
    acceleration = acceleration_at_tip(arm, at, list(bias_accelerations(arm, at, V, given.qd, *base, z.qdd)), *base)
    tip = TipMotion(at.tip, tip_twist(arm, at, V, given.base_twist), acceleration, np.zeros(6))
    linear, f = (None, np.zeros(6)) if case.grasp is None else at_grasp(case, z, tip)
    by_q, by_qd = joint_slopes(given, at, z.qdd, f)
    J, units = array([slope.twist for slope in by_qd]).reshape(-1, 6), np.eye(len(by_q))

    def found(passive_torque: Array, slope: JointSlope) -> Unknowns:
        torque, none = slope.torque + passive_torque, Unknowns(*(np.zeros(len(part)) for part in z))
        if linear is None:
            return none._replace(qdd=torque, base=slope.base)
        rates = skew(slope.turn) @ tip.pose.R, slope.shift, slope.twist, slope.acceleration
        wrench, *of_grasp = linear.rates(*rates)
        of_base = slope.base + shift_wrench(at.from_base, wrench)
        return Unknowns(*of_grasp)._replace(qdd=torque + J @ wrench, base=of_base)

    return {
        "q": [found(arm.stiffness * unit, slope) for unit, slope in zip(units, by_q, strict=True)],
        "qd": [found(arm.damping * unit, slope) for unit, slope in zip(units, by_qd, strict=True)],
    }


def at_grasp(case: ArmCase, z: Unknowns, tip: TipMotion) -> tuple[Linear, Array]:
    """Return the grasp's part of dL/dy, linearised in the tip's motion (its wrench comes first), and that wrench."""
    zero = [np.zeros(len(part)) for part in z]

    def residual(R: Array, p: Array, twist: Array, acceleration: Array) -> tuple[Array, ...]:
        def power(virtual: Array, *y: Array) -> object:
            moved = TipMotion(Pose.unchecked(R, p), twist, acceleration, virtual)
            return case.grasp_power(z, Unknowns(*y), moved, {})

        return gradient(power, np.zeros(6), *zero)

    motion = tip.pose.R, tip.pose.p, tip.twist, tip.acceleration
    return linearised(residual, *motion), residual(*motion)[0]
