"""Equations of motion of single bodies and arms for the oracle, before any contact.

World axes throughout; wrenches are [moment; force], accelerations plain second
derivatives.  Weights are forces on the links, never a fictitious base acceleration.
"""

from dataclasses import dataclass

import numpy as np

from tests.oracles.arithmetic import Arithmetic
from tests.oracles.arm_kinematics import (
    MovingFrame,
    base_frame,
    centripetal,
    cross,
    cross_matrix,
    link_frames,
    point_jacobian,
)


@dataclass(frozen=True)
class ArmEquations:
    """Hold M qdd + bias = tau - J^T f and the tip acceleration J qdd + tip_bias.

    Attributes:
        M: (N, N) mass matrix, armature on the diagonal [kg m^2, kg m, kg].
        bias: (N,) generalised force at qdd = 0: weights, velocities, base motion in;
            external link wrenches taken off [N m or N].
        tau: (N,) actuation less viscous damping [N m or N].
        J: (6, N) tip Jacobian, [angular; linear].
        tip_bias: (6,) tip [omega_dot; v_dot] at qdd = 0 [rad/s^2, m/s^2].
        tip: (3,) tip position [m].
        tip_twist: (6,) tip [omega; v] [rad/s, m/s].
        base_origin: (3,) position of the base frame's origin [m].
        momentum_J: (6, N) rate of all momentum about the base origin per unit qdd.
        momentum_bias: (6,) the same at qdd = 0, less weights and external wrenches.
    """

    M: np.ndarray
    bias: np.ndarray
    tau: np.ndarray
    J: np.ndarray
    tip_bias: np.ndarray
    tip: np.ndarray
    tip_twist: np.ndarray
    base_origin: np.ndarray
    momentum_J: np.ndarray
    momentum_bias: np.ndarray


@dataclass(frozen=True)
class BodyEquation:
    """Hold ``M alpha + bias = wrench`` of one rigid body about one of its points C.

    Attributes:
        M: (6, 6) for alpha = [omega_dot; v_dot of C], world axes.
        bias: (6,) velocity terms, less weight and external wrench [N m, N].
        R: (3, 3) body axes to world.
        omega: (3,) angular velocity [rad/s].
        v: (3,) velocity of C [m/s].
        C: (3,) position of C [m].
    """

    M: np.ndarray
    bias: np.ndarray
    R: np.ndarray
    omega: np.ndarray
    v: np.ndarray
    C: np.ndarray


def arm_equations(arm: dict, gravity: np.ndarray, numbers: Arithmetic) -> ArmEquations:
    """Return the contact-free equations of one arm in the case's state."""
    frames = link_frames(arm, numbers)
    base = base_frame(arm["base"], numbers)
    count = len(frames)
    M = np.diag(numbers.array([joint.get("armature", 0.0) for joint in arm["joints"]]))
    bias = numbers.array(np.zeros(count))
    momentum_J, momentum_bias = numbers.array(np.zeros((6, count))), numbers.array(np.zeros(6))
    wrenches = numbers.array(arm.get("link_wrench") or np.zeros((count, 6)))
    for k, (frame, link) in enumerate(zip(frames, arm["links"], strict=True)):
        com = numbers.array(link["com"])
        inertia = frame.R @ numbers.array(link["inertia"]) @ frame.R.T
        mass = numbers.array(link["mass"])[()]
        J = point_jacobian(frames, k, frame.point(com))
        M = M + mass * (J[3:].T @ J[3:]) + J[:3].T @ inertia @ J[:3]
        # Newton and Euler at qdd = 0, weight already moved to the left side.
        force = mass * (frame.point_acceleration(com) - gravity)
        moment = inertia @ frame.omega_dot + cross(frame.omega, inertia @ frame.omega)
        at_origin = point_jacobian(frames, k, frame.origin)
        bias = bias + J[:3].T @ moment + J[3:].T @ force - at_origin.T @ wrenches[k]
        lever = frame.point(com) - base.origin
        momentum_J = momentum_J + _momentum_rate(inertia @ J[:3], mass * J[3:], lever)
        momentum_bias = momentum_bias + moved(moment, force, lever)
        pushed = moved(wrenches[k, :3], wrenches[k, 3:], frame.origin - base.origin)
        momentum_bias = momentum_bias - pushed
    effort, tip = _joint_effort(arm, numbers), _tip(arm, frames, numbers)
    return ArmEquations(M, bias, effort, *tip, base.origin, momentum_J, momentum_bias)


def _joint_effort(arm: dict, numbers: Arithmetic) -> np.ndarray:
    """Return actuation less viscous damping, (N,) [N m or N]."""
    damping = numbers.array([joint.get("damping", 0.0) for joint in arm["joints"]])
    return numbers.array(arm["tau"]) - damping * numbers.array(arm["qd"])


def _tip(arm: dict, frames: list[MovingFrame], numbers: Arithmetic) -> tuple:
    """Return Jacobian, bias acceleration, position and twist of an arm's tip."""
    last, local = frames[-1], numbers.array(arm["tip"])
    position = last.point(local)
    return (
        point_jacobian(frames, len(frames) - 1, position),
        np.concatenate([last.omega_dot, last.point_acceleration(local)]),
        position,
        np.concatenate([last.omega, last.point_velocity(local)]),
    )


def _momentum_rate(moments: np.ndarray, forces: np.ndarray, lever: np.ndarray) -> np.ndarray:
    """Return columns of moments and forces moved to the foot of the lever, (6, N)."""
    return np.concatenate([moments + cross_matrix(lever) @ forces, forces])


def moved(moment: np.ndarray, force: np.ndarray, lever: np.ndarray) -> np.ndarray:
    """Return [moment + lever x force; force]: a wrench about the foot of the lever."""
    return np.concatenate([moment + cross(lever, force), force])


def object_equation(body: dict, gravity: np.ndarray, numbers: Arithmetic) -> BodyEquation:
    """Return the contact-free equation of the held object about its origin C."""
    R, C, omega, v = (numbers.array(body[key]) for key in ("R", "p", "omega", "v"))
    return body_equation(body, MovingFrame(R, C, omega, v, 0 * omega, 0 * v), gravity, numbers)


def body_equation(body: dict, frame: MovingFrame, gravity: np.ndarray, numbers: Arithmetic) -> BodyEquation:
    """Return the equation of a free body about the origin of its frame.

    Args:
        body: its mass, com, inertia, and the external wrench on it if there is one.
        frame: where it is and how it moves.
        gravity: (3,) [m/s^2].
        numbers: arithmetic.
    """
    R, omega = frame.R, frame.omega
    inertia = R @ numbers.array(body["inertia"]) @ R.T
    mass = numbers.array(body["mass"])[()]
    lever = R @ numbers.array(body["com"])
    # com acceleration = v_dot - lever x omega_dot + centripetal, a plain Jacobian.
    J_com = np.concatenate([-cross_matrix(lever), numbers.array(np.eye(3))], axis=1)
    M = mass * (J_com.T @ J_com)
    M[:3, :3] = M[:3, :3] + inertia
    force = mass * (centripetal(omega, lever) - gravity)
    bias = moved(cross(omega, inertia @ omega), force, lever)
    bias = bias - numbers.array(body.get("wrench", np.zeros(6)))
    return BodyEquation(M, bias, R, omega, frame.v, frame.origin)
