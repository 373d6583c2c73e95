"""The response of an arm itself to a change of its equations, which is its part of a column of the Jacobian.

The other arms and the object are affected by six numbers only, the rate at which its grasp would close, and by the
wrench on the object. For short arms, the responses to all joints are computed together (`joint_responses`): M^-1 is
computed once, and it also gives the columns by torques.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.arm.motion import ArmMotion
from holdfast.dynamics.closed.contact import Contact
from holdfast.dynamics.closed.joint_residuals import joint_residuals
from holdfast.dynamics.closed.second_solve import Load, along_free, loaded_response
from holdfast.dynamics.closed.tip_response import TipResponse
from holdfast.dynamics.closed.virtual_power import ArmCase, Unknowns
from holdfast.spatial.scalar import Array, array
from holdfast.spatial.spatial_vector import shift_wrench

OF_MOTION = ("q", "qd", "tau")  # arguments for which the responses to all joints can be computed together


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


def self_response(tip: TipResponse, motion: ArmMotion, c: Contact | None, r: Unknowns) -> SelfResponse:
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
    names: Sequence[str], case: ArmCase, z: Unknowns, tip: TipResponse, motion: ArmMotion, c: Contact | None
) -> dict[str, list[SelfResponse]]:
    """Return the responses of an arm itself to changes of each of its joints, by argument.

    Args:
        names: some of `OF_MOTION`.
        case: arguments of the arm's equations.
        z: the arm's part of the solution.
        tip: the arm's tip response.
        motion: the arm's motion.
        c: its contact, or None.
    """
    still = Unknowns(*(np.zeros(len(part)) for part in z))
    torques = [self_response(tip, motion, c, still._replace(qdd=-unit)) for unit in np.eye(len(z.qdd))]
    found = {"tau": torques}
    if torques and ("q" in names or "qd" in names):
        mobility = array([one.qdd for one in torques]).T
        at_base, at_tip = array([one.base for one in torques]).T, array([one.closing for one in torques]).T

        def of_residual(r: Unknowns) -> SelfResponse:
            other = self_response(tip, motion, c, r._replace(qdd=still.qdd))
            return other._replace(
                qdd=other.qdd - mobility @ r.qdd,
                base=other.base - at_base @ r.qdd,
                closing=other.closing - at_tip @ r.qdd,
            )

        found |= {name: [of_residual(r) for r in of] for name, of in joint_residuals(case, z).items()}
    return {name: found.get(name, []) for name in names}
