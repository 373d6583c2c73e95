"""What a law commands, and the torques that do it: the one place where a command becomes torques."""

from __future__ import annotations

from typing import NamedTuple

from holdfast.control.balanced_torques import bearing_wrenches
from holdfast.control.computed_torque import following_torques
from holdfast.dynamics.closed.chain_motion import ChainMotion
from holdfast.spatial.scalar import Array


class Command(NamedTuple):
    """What a law wishes for at one instant.

    Attributes:
        acceleration: (6,) true acceleration [omega_dot; v_dot] of C, world axes.
        wrenches: (arms, 6) wished wrenches of the arms on the object about the contacts, world axes.
        joint_acceleration: (n,) wished joint accelerations.
    """

    acceleration: Array
    wrenches: Array
    joint_acceleration: Array


def commanded_torques(motion: ChainMotion, command: Command) -> tuple[Array, Array]:
    """Return the torques of a command, (n,), and the grasp wrenches that they give, (arms, 6).

    The object's acceleration comes first: of the wrenches that give it and can be transmitted, and of the joint
    accelerations that follow it, the nearest to the wished ones are chosen. Effort limits and friction are not
    considered; near a singular posture an arm follows in the least-squares sense.

    Args:
        motion: the chain's motion, without torques; external wrenches in it count as known.
        command: the command.
    """
    wrenches, _, _ = bearing_wrenches(motion, command.acceleration, command.wrenches)
    tau = following_torques(motion, command.acceleration, wrenches, command.joint_acceleration)
    return tau, wrenches
