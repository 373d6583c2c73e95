"""Two Pandas that carry a box round a circle while their elbows swing, never at rest: a motion to step for long.

Configurations and torques are sums of a few sines of time, and a spring and a damper on every joint keep to them, so
that any simulator can be given the same law.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from benchmarks.bench.systems import follow
from holdfast import ClosedChain, Grasp, HeldObject, Pose, State, inverse_dynamics, project
from holdfast.control.grasp_forces import commanded_wrenches
from holdfast.robots import panda
from holdfast.robots.panda import FR3_ARMATURE
from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array, Scalar, array, cos, sin

PERIOD = 1.45  # s
CENTRE = Pose.translation(0.0, 0.0, 0.7)
RADIUS = 0.1  # m
TILT = 0.15  # rad, of the box about the line between the hands
SWING = 0.3  # rad, of the third joints
ELBOWS_UP = np.array([0.0, -0.6, 0.0, -2.3, 0.0, 3.3, 1.57])
STIFFNESS = np.tile([600.0, 600.0, 400.0, 400.0, 150.0, 150.0, 100.0], 2)  # N m/rad
DAMPING = np.tile([40.0, 40.0, 30.0, 30.0, 10.0, 10.0, 8.0], 2)  # N m s/rad

HARMONICS = 6
PHASES = 48  # at which configurations and torques are found
RATE = 2.0 * np.pi / PERIOD


@dataclass(frozen=True, eq=False)
class Circling:
    """The motion and the law that keeps to it, tau = drive(t) - stiffness q - damping qd.

    Attributes:
        chain: two Pandas and a box.
        configuration: (1 + 2 harmonics, n) of the joint positions: mean, cosines, sines [rad].
        drive: likewise, of the torques that the motion takes and those of the spring's moving end [N m].
    """

    chain: ClosedChain
    configuration: Array
    drive: Array

    def torque(self, t: Scalar, q: Array, qd: Array) -> Array:
        """Return the torques (n,) at a time and joint state; all of them may be traced [N m]."""
        return waves(t) @ self.drive - STIFFNESS * q - DAMPING * qd

    def state(self, t: float) -> State:
        """Return the closed state nearest to the motion at a time [s]."""
        pose, twist, _ = _box(t)
        near = State(waves(t) @ self.configuration, waves(t) @ rate_of(self.configuration), pose.wxyz_xyz, twist)
        return project(self.chain, near)[0]


@functools.cache
def circling() -> Circling:
    """Return the motion, its torques by inverse dynamics."""
    chain, times = _chain(), PERIOD * np.arange(PHASES) / PHASES
    configuration = _series(np.array([_configuration(chain, t) for t in times]))
    rate = rate_of(configuration)
    tau = []
    for t in times:
        pose, twist, acceleration = _box(t)
        state = State(waves(t) @ configuration, waves(t) @ rate, pose.wxyz_xyz, twist)
        wrenches = commanded_wrenches(chain, state, acceleration)
        tau.append(inverse_dynamics(chain, state, waves(t) @ rate_of(rate), wrenches))
    return Circling(chain, configuration, _series(np.array(tau)) + STIFFNESS * configuration + DAMPING * rate)


def waves(t: Scalar) -> Array:
    """Return 1, the cosines of a period's harmonics, their sines, (1 + 2 harmonics,)."""
    angles = [k * RATE * t for k in range(1, HARMONICS + 1)]
    return array([1.0, *(cos(x) for x in angles), *(sin(x) for x in angles)])


def rate_of(series: Array) -> Array:
    """Return the series of the derivative by time."""
    mean, cosines, sines = np.split(series, [1, 1 + HARMONICS])
    w = RATE * np.arange(1, HARMONICS + 1)[:, None]
    return np.concatenate([0.0 * mean, w * sines, -w * cosines])


def _series(values: Array) -> Array:
    """Return the first harmonics of values at the phases, (phases, n) -> (1 + 2 harmonics, n)."""
    found = np.fft.rfft(values, axis=0)[: HARMONICS + 1] / len(values)
    return np.concatenate([found[:1].real, 2.0 * found[1:].real, -2.0 * found[1:].imag])


def _chain() -> ClosedChain:
    """Return the Pandas face to face, the box between their hands."""
    facing = Pose(rotation.from_euler_zyx(np.pi, 0.0, 0.0), np.array([0.55, 0.0, 0.0]))
    arms = {
        "left": panda(Pose.translation(-0.55, 0.0, 0.0), armature=FR3_ARMATURE),
        "right": panda(facing, armature=FR3_ARMATURE),
    }
    hands = {"left": (-0.15, [0.5, -0.5, 0.5, -0.5]), "right": (0.15, [0.5, -0.5, -0.5, 0.5])}
    grasps = {
        name: Grasp("rigid", Pose(rotation.from_quaternion(np.array(wxyz)), np.array([x, 0.0, 0.0])))
        for name, (x, wxyz) in hands.items()
    }
    return ClosedChain(arms, HeldObject.box(3.0, 0.3, 0.2, 0.2), grasps)


def _box(t: float) -> tuple[Pose, Array, Array]:
    """Return where the box should be at a time, its twist, its acceleration, world axes."""
    c, s = np.cos(RATE * t), np.sin(RATE * t)
    along, across = np.array([0.0, c, s]), np.array([0.0, -s, c])
    turn, tilt_rate, tilt_acceleration = TILT * s, TILT * RATE * c, -TILT * RATE**2 * s
    pose = Pose(rotation.exp(np.array([turn, 0.0, 0.0])), CENTRE.p + RADIUS * along)
    twist = np.concatenate([[tilt_rate, 0.0, 0.0], RADIUS * RATE * across])
    return pose, twist, np.concatenate([[tilt_acceleration, 0.0, 0.0], -RADIUS * RATE**2 * along])


def _configuration(chain: ClosedChain, t: float) -> Array:
    """Return joint positions that hold the box where it should be, near elbows that swing."""
    guess = ELBOWS_UP + SWING * np.sin(RATE * t) * np.eye(7)[2]
    box = _box(t)[0]
    return np.concatenate([follow(arm, guess, box @ chain.grasps[name].frame) for name, arm in chain.arms.items()])
