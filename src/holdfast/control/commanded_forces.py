"""What a controller of the library commands of the hands: internal forces, and the limits that it keeps."""

from __future__ import annotations

from typing import Any

import numpy as np

from holdfast.control.balanced_torques import internal_part, pushes
from holdfast.control.commanded_torques import WithinLimits
from holdfast.control.controller import ControlLaw, GivenLaw
from holdfast.control.cooperative_law import CooperativeTorques
from holdfast.control.digital_law import DigitalTorque
from holdfast.control.gravity_compensation import GravityCompensation
from holdfast.control.law_parts import LawInput
from holdfast.control.momentum_observer import ObservedTorques
from holdfast.control.object_tracking import ObjectTracking
from holdfast.control.sampled import SampledTorque
from holdfast.control.torque_schedule import TorqueSchedule
from holdfast.control.traced_law import ControllerTorque
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.forces.limits import ForceLimits
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State


def within_wrappers(controller: Any) -> Any:
    """Return what gives the torques of a controller, without samples, observers and schedules around it."""
    while True:
        match controller:
            case GivenLaw() | SampledTorque() | DigitalTorque() | ObservedTorques():
                controller = controller.law
            case ControlLaw():
                controller = controller.torque
            case ControllerTorque():
                controller = controller.controller
            case TorqueSchedule():
                controller = controller.beside
            case _:
                return controller


def commands_forces(controller: Any) -> bool:
    """Return whether a controller says which forces it commands; none says so of a chain with branches."""
    own = within_wrappers(controller)
    return isinstance(own, CooperativeTorques | GravityCompensation | ObjectTracking) and not own.chain.beyond_serial


def commanded_internal_wrenches(controller: Any, t: float, state: State) -> Array:
    """Return the internal part of the wrenches that a controller wishes for, before integrals and limits, (arms, 6).

    About the contacts, world axes [N m, N]. An exact model without limits gives just these.

    Args:
        controller: one for which `commands_forces` holds.
        t: time [s].
        state: a state of its chain.
    """
    own = within_wrappers(controller)
    motion = chain_motion(own.chain, state, np.zeros(own.chain.joint_count), Inputs().shaped(own.chain))
    if not isinstance(own, CooperativeTorques):
        return internal_part(motion, pushes(motion, own.internal_force))
    parts = (own.motion, own.forces, own.posture)
    given = {name: np.zeros(shape) for part in parts for name, shape in part.parameters(own.chain).items()}
    x = LawInput(t, state, motion, own.forces.memory(own.chain), given)
    return internal_part(motion, own.forces.commanded(x, own.motion.acceleration(x)))


def limits_kept(controller: Any) -> ForceLimits | None:
    """Return the limits that a controller keeps; None of one that keeps none."""
    within = getattr(within_wrappers(controller), "within", None)
    return within.limits if isinstance(within, WithinLimits) else None
