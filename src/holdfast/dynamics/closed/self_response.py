"""The response of an arm itself to a change of its equations, which is its part of a column of the Jacobian.

The other arms and the object are affected by six numbers only, the rate at which its grasp would close, and by the
wrench on the object. For short arms, the responses to all joints are computed together (`joint_responses`): M^-1 is
computed once, and it also gives the columns by torques. The changes of the equations are computed together, too
(`joint_residuals`): those of the torques and of the tip's motion come from `arm.joint_slopes`, those of the grasp's
part from linearising its virtual power in the tip's motion. They equal those of `ArmCase.residual`, with a fifth of the
operations.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.bias import acceleration_at_tip, bias_accelerations
from holdfast.dynamics.arm.forward_kinematics import forward_kinematics, link_twists, tip_twist
from holdfast.dynamics.arm.joint_slopes import JointSlope, joint_slopes
from holdfast.dynamics.arm.motion import ArmMotion
from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.closed.second_solve import Load, along_free, loaded_response
from holdfast.dynamics.closed.tip_response import TipResponse
from holdfast.dynamics.closed.virtual_power import ArmCase, ArmUnknowns, TipMotion
from holdfast.spatial.differentiation import gradient, linearised
from holdfast.spatial.linear import Linear
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, array
from holdfast.spatial.spatial_vector import shift_wrench
from holdfast.spatial.symmetric import mirrored
from holdfast.spatial.vector import skew

JOINT_ARGUMENTS = ("q", "qd", "tau")  # arguments for which the responses to all joints can be computed together


class SelfResponse(NamedTuple):
    """The response of an arm to a change of its dL/dy, if its grasp transmits nothing.

    Attributes:
        qdd: (N,) joint accelerations.
        base: (6,) wrench of the base on the arm.
        closing: (6,) tip's acceleration minus r_f, by which its grasp would close.
        known: (6,) its wrench along the free directions.
        bushing: (6,) rate of the wrench of a bushing; (0,) for other grasps.
        on_object: (6,) wrench on the object about C.
    """

    qdd: Array
    base: Array
    closing: Array
    known: Array
    bushing: Array
    on_object: Array


def self_response(tip: TipResponse, motion: ArmMotion, c: Contact | None, r: ArmUnknowns) -> SelfResponse:
    """Return the response of an arm itself to the rate r of its dL/dy.

    Args:
        tip: the arm's tip response.
        motion: the arm's motion.
        c: its contact, or None.
        r: rate of its dL/dy.
    """
    load = Load(-r.qdd, -r.wrench, -r.contact_acceleration, np.zeros(6))
    loaded = loaded_response(tip, motion, load)
    known, closing, on_object = np.zeros(6), np.zeros(6), np.zeros(6)
    if c is not None:
        known = along_free(c, load.free)
        closing = loaded.free_acceleration - load.gap - loaded.mobility.apply(known)
        on_object = shift_wrench(c.offset, known) - r.object_acceleration
    qdd, base = loaded.back_substitute(known)
    return SelfResponse(qdd, base + r.base, closing, known, r.known, on_object)


def joint_responses(
    names: Sequence[str], case: ArmCase, z: ArmUnknowns, tip: TipResponse, motion: ArmMotion, c: Contact | None
) -> dict[str, list[SelfResponse]]:
    """Return the responses of an arm itself to changes of each of its joints, by argument, and to torques in any case.

    Args:
        names: some of `JOINT_ARGUMENTS`.
        case: arguments of the arm's equations.
        z: the arm's part of the solution.
        tip: the arm's tip response.
        motion: the arm's motion.
        c: its contact, or None.
    """
    still = ArmUnknowns(*(np.zeros(len(part)) for part in z))
    torques = [self_response(tip, motion, c, still._replace(qdd=-unit)) for unit in np.eye(len(z.qdd))]
    mobility = mirrored(array([one.qdd for one in torques])) if torques else np.zeros((0, 0))
    found = {"tau": [one._replace(qdd=row) for one, row in zip(torques, mobility, strict=True)]}
    if torques and ("q" in names or "qd" in names):
        at_base, at_tip = array([one.base for one in torques]).T, array([one.closing for one in torques]).T

        def of_residual(r: ArmUnknowns) -> SelfResponse:
            other = self_response(tip, motion, c, r._replace(qdd=still.qdd))
            return other._replace(
                qdd=other.qdd - mobility @ r.qdd,
                base=other.base - at_base @ r.qdd,
                closing=other.closing - at_tip @ r.qdd,
            )

        found |= {name: [of_residual(r) for r in of] for name, of in joint_residuals(case, z).items()}
    return {name: found.get(name, []) for name in {"tau", *names}}


def joint_residuals(case: ArmCase, z: ArmUnknowns) -> dict[str, list[ArmUnknowns]]:
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

    def found(passive_torque: Array, slope: JointSlope) -> ArmUnknowns:
        torque, none = slope.torque + passive_torque, ArmUnknowns(*(np.zeros(len(part)) for part in z))
        if linear is None:
            return none._replace(qdd=torque, base=slope.base)
        rates = skew(slope.turn) @ tip.pose.R, slope.shift, slope.twist, slope.acceleration
        wrench, *of_grasp = linear.rates(*rates)
        of_base = slope.base + shift_wrench(at.from_base, wrench)
        return ArmUnknowns(*of_grasp)._replace(qdd=torque + J @ wrench, base=of_base)

    return {
        "q": [found(arm.stiffness * unit, slope) for unit, slope in zip(units, by_q, strict=True)],
        "qd": [found(arm.damping * unit, slope) for unit, slope in zip(units, by_qd, strict=True)],
    }


def at_grasp(case: ArmCase, z: ArmUnknowns, tip: TipMotion) -> tuple[Linear, Array]:
    """Return the grasp's part of dL/dy, linearised in the tip's motion (its wrench comes first), and that wrench."""
    zero = [np.zeros(len(part)) for part in z]

    def residual(R: Array, p: Array, twist: Array, acceleration: Array) -> tuple[Array, ...]:
        def power(virtual: Array, *y: Array) -> object:
            moved = TipMotion(Pose.unchecked(R, p), twist, acceleration, virtual)
            return case.grasp_power(z, ArmUnknowns(*y), moved, {})

        return gradient(power, np.zeros(6), *zero)

    motion = tip.pose.R, tip.pose.p, tip.twist, tip.acceleration
    return linearised(residual, *motion), residual(*motion)[0]
