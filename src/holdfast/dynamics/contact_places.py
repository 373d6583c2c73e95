"""Contacts: the axes and points to which grasp wrenches refer, and the attitude Theta of each (paper, Appendix A).

Theta describes the attitude of the contact frame, which moves with the object, relative to the tip frame: R_Theta =
R_tip^T R_contact. Its rate Theta_dot = F(Theta) W follows from the relative angular velocity omega_object - omega_tip =
h W.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple, get_args

import numpy as np

from holdfast.dynamics.arm.forward_kinematics import forward_kinematics
from holdfast.dynamics.closed.chain_motion import chain_motion
from holdfast.dynamics.trunk.trunk_motion import trunk_at_rest
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp import Grasp
from holdfast.spatial import rotation
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array, each
from holdfast.state import Inputs, State, require_fit, shaped_inputs


class ContactPlace(NamedTuple):
    """The axes and the contact point of one grasp.

    Attributes:
        grasp: the grasp.
        R: (3, 3) rotation from the axes of its free and transmitted directions to world axes.
        offset: (3,) from C to the contact point, world axes [m]. If the object slides, the contact point is the tip's
            origin.
    """

    grasp: Grasp
    R: Array
    offset: Array


def contact_places(chain: ClosedChain, state: State) -> list[ContactPlace]:
    """Return axes and contact point of each grasp, in order. O(l), or O(n) if any of them follow the tips."""
    frame, found = state.object_frame, []
    tips = tip_frames(chain, state, [name for name, grasp in chain.grasps.items() if grasp.of_kind.follows_tip])
    for name, grasp in chain.grasps.items():
        kind, R, offset = grasp.of_kind, frame.R @ grasp.frame.R, frame.R @ grasp.frame.p
        if name in tips:
            tip = tips[name]
            R, offset = kind.axes(R, tip.R), tip.p - frame.p if kind.slides else offset
        found.append(ContactPlace(grasp, R, offset))
    return found


def tip_frames(chain: ClosedChain, state: State, names: Sequence[str]) -> dict[str, Pose]:
    """Return the tip poses of the named arms in the world. O(n)."""
    mounts = trunk_at_rest(chain, state).mounts
    arms = [chain.arms[name].standing_at(mounts[name].frame) if name in mounts else chain.arms[name] for name in names]
    own = [state.q[chain.joints[name]] for name in names]
    return dict(zip(names, each(lambda arm, q: forward_kinematics(arm, q).tip, arms, own), strict=True))


Parameters = Literal["quaternion", "euler"]
EULER_SINGULAR = 1e-6  # cos(pitch) below which the rates of yaw and roll are not defined


class ContactAttitude(NamedTuple):
    """The attitude of one grasp.

    Attributes:
        theta: (4,) unit quaternion (w >= 0), or (3,) Euler angles yaw, pitch, roll [rad].
        F: (m, n_g) matrix in Theta_dot = F W.
        W: (n_g,) relative angular velocity [rad/s], along the contact frame's free axes for a hinge and a soft
            finger, and along world axes for a ball.
    """

    theta: Array
    F: Array
    W: Array

    @property
    def rate(self) -> Array:
        """Theta_dot = F(Theta) W (a.4)."""
        return self.F @ self.W


@np.errstate(all="ignore")  # what overflows is refused
def contact_attitudes(
    chain: ClosedChain,
    state: State,
    parameters: Parameters = "quaternion",
    inputs: Inputs | None = None,
) -> dict[str, ContactAttitude]:
    """Return the attitude of every grasp, by arm name: Theta_dot = F(Theta) W (a.4). O(n) + O(l).

    Quaternions have no singularity; Euler angles (R = Rz Ry Rx) are singular at a pitch of +-pi/2.

    Args:
        chain: the chain.
        state: positions and velocities.
        parameters: "quaternion" (m = 4) or "euler" (m = 3).
        inputs: base motion, if the bases move.

    Raises:
        StateError: if Euler angles are requested where they are singular, other parameters, or rates that overflow.
    """
    require_fit(chain, state)
    if parameters not in get_args(Parameters):
        known = " or ".join(map(repr, get_args(Parameters)))
        raise StateError(f"contact_attitudes: parameters: expected {known}, got {checks.short(parameters)}")
    motion = chain_motion(chain, state, np.zeros(chain.joint_count), shaped_inputs(chain, inputs))
    result = {}
    for name, c in zip(chain.grasps, motion.contacts, strict=True):
        R = motion.arms[name].at.tip.R.T @ c.R
        free = c.R.T @ c.h  # (3, n_g) axes of W as columns, in the contact frame of the object's side
        checks.finite(np.append(R, c.W), "contact attitudes")
        if parameters == "quaternion":
            theta = rotation.to_quaternion(R)
            result[name] = ContactAttitude(theta, quaternion_rate_map(theta) @ free, c.W)
        else:
            theta = rotation.to_euler_zyx(R)
            if abs(math.cos(theta[1])) < EULER_SINGULAR:
                raise StateError(
                    f"grasp '{name}': Euler angles are singular at pitch {theta[1]:.6f} rad; try"
                    " parameters='quaternion'"
                )
            result[name] = ContactAttitude(theta, euler_rate_map(theta) @ free, c.W)
    return result


def quaternion_rate_map(q: Array) -> Array:
    """Return F-bar, (4, 3), with q_dot = F-bar omega, omega along the rotated axes, those of the object's side."""
    w, x, y, z = q
    return 0.5 * np.array([[-x, -y, -z], [w, -z, y], [z, w, -x], [-y, x, w]])


def euler_rate_map(yaw_pitch_roll: Array) -> Array:
    """Return F-bar, (3, 3), with d(yaw, pitch, roll)/dt = F-bar omega, omega along the rotated axes."""
    _, pitch, roll = yaw_pitch_roll
    c, s = math.cos(roll), math.sin(roll)
    sec, tan = 1 / math.cos(pitch), math.tan(pitch)
    return np.array([[0.0, s * sec, c * sec], [0.0, c, -s], [1.0, s * tan, c * tan]])
