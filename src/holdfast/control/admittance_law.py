"""Admittance: arms that are commanded by rates give way to measured wrenches."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from holdfast.control.balanced_torques import internal_part, pushes, sum_at_object
from holdfast.control.controller import ControlLaw, Torque
from holdfast.control.gains import gain_matrix, require_stable
from holdfast.control.paths import ObjectPath, Target, path_function, pose_error
from holdfast.control.posture_control import PostureControl
from holdfast.dynamics.arm.forward_kinematics import jacobian
from holdfast.dynamics.closed.chain_motion import chain_motion, needed_wrench
from holdfast.errors import MethodNotApplicable
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.fingerprint import exact_fingerprint
from holdfast.model.serial_chain import serial_chain
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.linalg import least_solution
from holdfast.spatial.scalar import Array, Scalar, concatenate
from holdfast.spatial.spatial_vector import shift_twist
from holdfast.state import Inputs, State


def admittance_law(
    chain: ClosedChain,
    path: Callable[[float], Target] | ObjectPath,
    *,
    stiffness: ArrayLike,
    damping: ArrayLike,
    inertia: ArrayLike,
    internal_damping: float,
    contact_stiffness: float,
    sample_time: float,
    force: float = 0.0,
    posture: PostureControl | None = None,
) -> ControlLaw:
    """Return the law of joint rates that stand in the place of torques, for arms commanded by position or velocity.

    The object's commanded twist V_c gives way to the external wrench w as M_d (a_c - a_d) + D (V_c - V_d) = K e + w, in
    implicit Euler steps of the damper; w is what the measured grasp wrenches f leave of the object's motion. Each tip
    follows its contact, and retreats from internal force, v_i = -(f_i - f_i,d)_internal / D_int. Joint rates are the
    nearest to those of the posture, frequency (q_rest - q + r). Positions are integrals of the rates. The law has the
    parameter `measured_wrenches` (arms, 6), as in `ForwardResult`.

    Args:
        chain: the controller's model of the chain, arms in the world.
        path: function of t [s] that returns the target, or a path object, whose method `at` is used.
        stiffness: K, (6, 6), its diagonal (6,), or one number for all [N m/rad, N/m].
        damping: D, likewise [N m s/rad, N s/m].
        inertia: M_d, likewise [kg m^2, kg].
        internal_damping: D_int, the same for turning [N m s/rad] and shifting [N s/m].
        contact_stiffness: k, the largest stiffness of a contact in series with its arm [N m/rad, N/m].
        sample_time: T [s], that of `sampled` or of the robot.
        force: wished push of every arm along its contact normal into the object [N].
        posture: the posture of redundant arms; None for the smallest rates.

    Raises:
        ModelError: k T / D_int >= 1, the limit of stability with one sample of delay; a matrix is not positive
            (semi)definite, or a number is out of range.
        MethodNotApplicable: the chain has a trunk, or no arm has a grasp.

    Reference:
        Caccavale and Uchiyama, Cooperative Manipulation, Springer Handbook of Robotics, 2016.
    """
    serial_chain(chain, "admittance law: chain")
    checks.instance(posture, (PostureControl, type(None)), "admittance law: posture")
    if chain.trunk is not None or not chain.grasps:
        got = "a trunk" if chain.grasps else "no grasp"
        raise MethodNotApplicable(f"admittance_law: expected arms in the world that hold the object, got {got}")
    numbers = {"internal_damping": internal_damping, "contact_stiffness": contact_stiffness, "sample_time": sample_time}
    damper, spring, period = (checks.number(x, f"admittance law: {k}", above=0.0) for k, x in numbers.items())
    product = "contact_stiffness * sample_time / internal_damping"
    require_stable(
        "admittance law: internal_damping", product, spring * period / damper, 1.0, "with one sample of delay"
    )
    null = PostureControl(frequency=0.0) if posture is None else posture
    null.require(chain)
    rates = AdmittanceRates(
        chain,
        path_function(path, "admittance law: path"),
        gain_matrix(stiffness, "admittance law: stiffness"),
        gain_matrix(damping, "admittance law: damping"),
        gain_matrix(inertia, "admittance law: inertia", definite=True),
        damper,
        period,
        checks.number(force, "admittance law: force"),
        null,
    )
    parameters = {"measured_wrenches": (len(chain.arms), 6)}
    return ControlLaw(rates, np.zeros(12), parameters, exact_fingerprint(rates) or "")


@dataclass(frozen=True, eq=False)
class AdmittanceRates(Frozen):
    """The joint rates of `admittance_law`; the attributes are its arguments.

    The memory is V_c - V_d and a_c of the last sample.
    """

    chain: ClosedChain
    path: Callable[[Any], Target]
    stiffness: Array
    damping: Array
    inertia: Array
    internal_damping: float
    sample_time: float
    force: float
    posture: PostureControl

    def for_chain(self, chain: ClosedChain) -> Torque:
        """Return the rates for a chain whose grasps have changed."""
        return replace(self, chain=chain)

    @np.errstate(all="ignore")  # what overflows is refused
    def __call__(self, t: Scalar, state: State, memory: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
        """Return the joint rates (n,) and the memory."""
        chain, T, f = self.chain, self.sample_time, given["measured_wrenches"]
        target, motion = self.path(t), chain_motion(chain, state, np.zeros(chain.joint_count), Inputs().shaped(chain))
        external = needed_wrench(motion, memory[6:]) - sum_at_object(motion, f)
        pull = self.stiffness @ pose_error(target.pose, state.object_frame) + external
        away = np.linalg.inv(self.inertia + T * self.damping) @ (self.inertia @ memory[:6] + T * pull)
        twist = target.twist + away
        excess = internal_part(motion, f - pushes(motion, self.force))
        off, ahead, _ = self.posture.departure(chain, t, state.q)
        wished, rates = ahead + self.posture.frequency * off, []
        contacts = dict(zip(chain.grasps, motion.contacts, strict=True))
        for i, (name, arm) in enumerate(motion.arms.items()):
            own = wished[chain.joints[name]]
            if name in contacts:
                c = contacts[name]
                rows = c.K @ jacobian(arm.arm, arm.at)
                tip = shift_twist(c.offset, twist) - excess[i] / self.internal_damping
                own = own + least_solution(rows, c.K @ tip - rows @ own)
            rates.append(own)
        kept = concatenate([away, target.acceleration + (away - memory[:6]) / T])
        return checks.finite(concatenate(rates), "admittance law"), checks.finite(kept, "admittance law: memory")
