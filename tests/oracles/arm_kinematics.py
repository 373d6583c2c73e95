"""Plain kinematics of one arm for the oracle: world axes, base to tip.

Every link carries its own pose, velocity and the acceleration it would have with
all joint accelerations at zero.  Textbook vector formulas only; no spatial
operators, so that a mistake in the library's operators cannot repeat here.
"""

from dataclasses import dataclass

import numpy as np

from tests.oracles.arithmetic import Arithmetic


@dataclass(frozen=True)
class MovingFrame:
    """Hold pose and motion of one frame, world axes; accelerations at qdd = 0.

    Attributes:
        R: (3, 3) frame axes to world.
        origin: (3,) position of the frame origin [m].
        omega: (3,) angular velocity [rad/s].
        v: (3,) velocity of the origin [m/s].
        omega_dot: (3,) angular acceleration [rad/s^2].
        v_dot: (3,) acceleration of the origin [m/s^2].
        axis: (3,) unit axis of the joint that moves the frame; None for a base.
        revolute: whether that joint turns (otherwise it slides).
    """

    R: np.ndarray
    origin: np.ndarray
    omega: np.ndarray
    v: np.ndarray
    omega_dot: np.ndarray
    v_dot: np.ndarray
    axis: np.ndarray | None = None
    revolute: bool = True

    def point(self, local: np.ndarray) -> np.ndarray:
        """Return the world position [m] of a point given in frame axes."""
        return self.origin + self.R @ local

    def point_velocity(self, local: np.ndarray) -> np.ndarray:
        """Return the velocity [m/s] of a point fixed in the frame, world axes."""
        return self.v + cross(self.omega, self.R @ local)

    def point_acceleration(self, local: np.ndarray) -> np.ndarray:
        """Return the acceleration [m/s^2] of a point fixed in the frame, world axes."""
        arm = self.R @ local
        return self.v_dot + cross(self.omega_dot, arm) + centripetal(self.omega, arm)


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the cross product of two 3-vectors of any scalar kind."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def cross_matrix(a: np.ndarray) -> np.ndarray:
    """Return the 3x3 matrix X with ``X @ b = a x b``."""
    zero = a[0] * 0
    return np.array([[zero, -a[2], a[1]], [a[2], zero, -a[0]], [-a[1], a[0], zero]])


def centripetal(omega: np.ndarray, arm: np.ndarray) -> np.ndarray:
    """Return omega x (omega x arm), the acceleration [m/s^2] due to turning."""
    return cross(omega, cross(omega, arm))


def rotation_about(axis: np.ndarray, angle, numbers: Arithmetic) -> np.ndarray:
    """Return the rotation matrix about a unit axis by an angle [rad] (Rodrigues)."""
    k = cross_matrix(axis)
    return np.eye(3, dtype=int) + numbers.sin(angle) * k + (1 - numbers.cos(angle)) * (k @ k)


def base_frame(base: dict, numbers: Arithmetic) -> MovingFrame:
    """Return the prescribed pose and motion of an arm's base."""
    keys = ("R", "p", "omega", "v", "omega_dot", "v_dot")
    return MovingFrame(*(numbers.array(base[key]) for key in keys))


def link_frames(arm: dict, numbers: Arithmetic) -> list[MovingFrame]:
    """Return the moving frame of every link of an arm, base to tip."""
    parent = base_frame(arm["base"], numbers)
    q, qd = numbers.array(arm["q"]), numbers.array(arm["qd"])
    frames = []
    for joint, angle, rate in zip(arm["joints"], q, qd, strict=True):
        parent = child_frame(parent, joint, angle, rate, numbers)
        frames.append(parent)
    return frames


def child_frame(parent: MovingFrame, joint: dict, q, qd, numbers: Arithmetic) -> MovingFrame:
    """Return the frame of the link behind one joint at position q and rate qd."""
    R = parent.R @ numbers.array(joint["R0"])
    local_axis = numbers.array(joint["axis"])
    axis = R @ local_axis
    offset = parent.R @ numbers.array(joint["p0"])
    revolute = joint["type"] == "revolute"
    if not revolute:
        offset = offset + axis * q
    w = parent.omega
    v = parent.v + cross(w, offset)
    v_dot = parent.v_dot + cross(parent.omega_dot, offset) + centripetal(w, offset)
    omega, omega_dot = w, parent.omega_dot
    if revolute:
        R = R @ rotation_about(local_axis, q, numbers)
        omega, omega_dot = w + axis * qd, omega_dot + cross(w, axis) * qd
    else:
        # Sliding along a turning axis: once for the turned velocity, once for the
        # growing lever arm, hence the factor two of Coriolis.
        v, v_dot = v + axis * qd, v_dot + 2 * cross(w, axis) * qd
    return MovingFrame(R, parent.origin + offset, omega, v, omega_dot, v_dot, axis, revolute)


def point_jacobian(frames: list[MovingFrame], link: int, point: np.ndarray) -> np.ndarray:
    """Return the geometric Jacobian of a point of one link.

    Args:
        frames: the arm's link frames, base to tip.
        link: index of the link that carries the point, from 0 at the base.
        point: (3,) world position of the point [m].

    Returns:
        (6, N) columns [omega; velocity of the point] per unit joint rate, world axes.
    """
    zero = point[0] * 0
    jacobian = np.full((6, len(frames)), zero, dtype=point.dtype)
    for j, frame in enumerate(frames[: link + 1]):
        if frame.revolute:
            jacobian[:3, j] = frame.axis
            jacobian[3:, j] = cross(frame.axis, point - frame.origin)
        else:
            jacobian[3:, j] = frame.axis
    return jacobian
