"""The quantities of one arm that depend neither on the grasp forces nor on the dynamics algorithm."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from holdfast.dynamics.arm import bias as bias_sweep
from holdfast.dynamics.arm.bias import Bias
from holdfast.dynamics.arm.forward_kinematics import Kinematics, forward_kinematics, link_twists, tip_twist
from holdfast.model.arm import Arm
from holdfast.spatial.scalar import Array
from holdfast.spatial.spatial_vector import shift_wrench, unrotate


@dataclass(frozen=True, eq=False)
class ArmInputs:
    """One arm with its state, torques, base motion and external wrenches.

    Attributes:
        arm: the arm.
        q, qd: (N,) joint positions and rates.
        tau: (N,) joint torques.
        base_twist: (6,) twist of the base origin, world axes.
        base_acceleration: (6,) acceleration of the base origin minus [0; g], world axes.
        link_wrenches: (N, 6) external wrenches about the link origins, world axes, or None.
        base_columns: (6, c) acceleration of the base origin per acceleration of a trunk's columns, world axes; None
            without a trunk.
    """

    arm: Arm
    q: Array
    qd: Array
    tau: Array
    base_twist: Array
    base_acceleration: Array
    link_wrenches: Array | None = None
    base_columns: Array | None = None


@dataclass(frozen=True, eq=False)
class ArmMotion:
    """The motion of an arm: the input of every forward dynamics algorithm.

    Attributes:
        arm: the arm.
        at: its configuration.
        tip_twist: (6,) V(0) of the tip point, world axes.
        bias: wrenches and tip acceleration at qdd = 0.
        passive_torque: (N,) torques of dampers and springs, damping qd + stiffness (q - rest).
        torque: (N,) T = tau - passive_torque.
        base_columns: (6, c) acceleration of its base per acceleration of a trunk's columns; None without a trunk.
        known: (6,) wrench of the tip on the object that follows from the state (of a bushing), world axes, which is
            included in the bias; None for none.
    """

    arm: Arm
    at: Kinematics
    tip_twist: Array
    bias: Bias
    passive_torque: Array
    torque: Array
    base_columns: Array | None = None
    known: Array | None = None

    def exerting(self, f: Array) -> ArmMotion:
        """Return the arm with a known wrench f (6,) of its tip on the object, whose reaction acts on its last link.

        Args:
            f: wrench about the tip point, world axes.
        """
        arm, bias = self.arm, self.bias
        reaction = shift_wrench(arm.tip.p, unrotate(self.at.end, f))
        if not arm.joints:
            return replace(self, bias=bias._replace(of_base=reaction), known=f)
        wrenches = (*bias.wrenches[:-1], bias.wrenches[-1] + reaction)
        return replace(self, bias=bias._replace(wrenches=wrenches), known=f)

    def unknown(self, f: Array) -> Array:
        """Return a total wrench f (6,) of the tip on the object minus the known one."""
        return f if self.known is None else f - self.known

    @property
    def base_to_tip(self) -> Array:
        """(3,) from the base origin to the tip point, world axes [m]."""
        return self.at.from_base


def arm_motion(given: ArmInputs, at: Kinematics | None = None) -> ArmMotion:
    """Return the motion of one arm: configuration, twists and bias. Outward sweeps, O(N).

    Args:
        given: the arm and its inputs.
        at: its configuration, if it is known.
    """
    arm = given.arm
    at = forward_kinematics(arm, given.q) if at is None else at
    twists = link_twists(arm, at, given.qd, given.base_twist)
    b = bias_sweep.bias(arm, at, twists, given.qd, given.base_twist, given.base_acceleration, given.link_wrenches)
    passive_torque = arm.damping * given.qd + arm.stiffness * (given.q - arm.rest)
    at_tip = tip_twist(arm, at, twists, given.base_twist)
    return ArmMotion(arm, at, at_tip, b, passive_torque, given.tau - passive_torque, given.base_columns)


def resting(arm: Arm, at: Kinematics, base_columns: Array | None = None) -> ArmMotion:
    """Return an arm at a configuration without torques, velocities, gravity or external wrenches."""
    none, n = np.zeros(6), arm.joint_count
    return ArmMotion(arm, at, none, Bias((none,) * n, none), np.zeros(n), np.zeros(n), base_columns)


def driven(motion: ArmMotion, torque: Array, base_acceleration: Array) -> ArmMotion:
    """Return the arm at rest at the same configuration, without gravity, with given torques and base acceleration.

    Args:
        motion: the arm's motion.
        torque: (N,) joint torques.
        base_acceleration: (6,) acceleration of the base origin, world axes.
    """
    arm, at, none, still = motion.arm, motion.at, np.zeros(6), np.zeros(motion.arm.joint_count)
    twists = (none,) * arm.joint_count
    b = bias_sweep.bias(arm, at, twists, still, none, base_acceleration)
    return ArmMotion(arm, at, none, b, still, torque, motion.base_columns)


def at_rest(motion: ArmMotion) -> ArmMotion:
    """Return the arm at the same configuration without torques, velocities, gravity or external wrenches."""
    return resting(motion.arm, motion.at, motion.base_columns)
