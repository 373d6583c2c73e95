"""What actions command, and parts of observations and rewards, as functions that can be compiled.

The control laws have the parameter `action`, which is constant in a control step and clipped to [-1, 1].
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.control.computed_torque import computed_torque
from holdfast.control.controller import ControlLaw
from holdfast.control.grasp_forces import commanded_wrenches
from holdfast.control.gravity_compensation import GravityCompensation
from holdfast.dynamics.constraint import length_scale
from holdfast.dynamics.contact_places import contact_places
from holdfast.forces.force_split import motion_wrenches
from holdfast.forces.margins import joint_limits
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.fingerprint import exact_fingerprint
from holdfast.model.joint import Joint
from holdfast.spatial.pose import Pose
from holdfast.spatial.rotation import log
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, maximum, minimum, sqrt
from holdfast.spatial.spatial_vector import shift_wrench, unrotate
from holdfast.state import State

OBSERVED_RATE = 10.0  # rad/s or m/s: bound of observed rates of joints without a limit
OBSERVED_SLIDE = 10.0  # m: bound of observed positions of prismatic joints without a limit
OBSERVED_TURN, OBSERVED_SHIFT = np.pi, 2.0  # bounds of observed pose errors [rad, m]
OBSERVED_FORCE = 10.0  # bound of observed forces, as a multiple of that of internal forces
OBSERVED_TWIST = 5.0  # bound of observed twists [rad/s, m/s]


def object_law(
    chain: ClosedChain, acceleration: Array, internal_force: float, internal_force_span: float, joint_damping: float
) -> ControlLaw:
    """Return the law that gives the object an acceleration under an internal force; an action has 7 entries.

    Computed torque for the object acceleration alpha = acceleration * a[:6] and the internal force
    internal_force + internal_force_span * a[6].

    Args:
        chain: the controller's model of the chain.
        acceleration: (6,) largest [omega_dot; v_dot] of C, world axes [rad/s^2, m/s^2].
        internal_force: push of every arm along its contact normal at a[6] = 0 [N].
        internal_force_span: force that a[6] = 1 adds to it [N].
        joint_damping: damping of the joint motion that does not move any contact [1/s].
    """

    def torque(t: Scalar, now: State, memory: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
        a = clipped(given["action"])
        alpha = acceleration * a[:6]
        wrenches = commanded_wrenches(chain, now, alpha, internal_force + internal_force_span * a[6])
        return computed_torque(chain, now, alpha, wrenches, joint_damping), memory

    return _keyed(torque, 7, chain, acceleration, internal_force, internal_force_span, joint_damping)


def joint_law(chain: ClosedChain, torque: Array, internal_force: float, joint_damping: float) -> ControlLaw:
    """Return the law that adds an action's torques to gravity compensation and damping; an action has n entries.

    tau = `GravityCompensation(chain, internal_force, joint_damping)` + torque * a.

    Args:
        chain: the controller's model of the chain.
        torque: (n,) torques at an action of 1 [N m or N].
        internal_force: push of every arm along its contact normal [N].
        joint_damping: d in tau = -d qd [N m s/rad or N s/m].

    Raises:
        MethodNotApplicable: a trunk whose base floats under gravity.
    """
    weightless = GravityCompensation(chain, internal_force, joint_damping)

    def law(t: Scalar, now: State, memory: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
        tau, _ = weightless(t, now, None)
        return tau + torque * clipped(given["action"]), memory

    return _keyed(law, chain.joint_count, chain, torque, internal_force, joint_damping)


def clipped(action: Array) -> Array:
    """Return actions clipped to [-1, 1]."""
    return minimum(maximum(action, -1.0), 1.0)


def _keyed(law: Callable[..., Any], size: int, *numbers: Any) -> ControlLaw:
    """Return a law with the parameter `action` (size,), and a key for the cache if its numbers have a fingerprint."""
    known = exact_fingerprint(list(numbers))
    source = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()
    key = f"{law.__qualname__}/{known}/{source}" if known else ""
    return ControlLaw(law, parameters={"action": (size,)}, key=key)


def away(to: Pose, at: Pose) -> Array:
    """Return the displacement from the frame `at` to the frame `to`, (6,): [rotation vector; shift], world axes."""
    return concatenate([log(to.R @ at.R.T), to.p - at.p])


def size(v: Array) -> Scalar:
    """Return the length of a vector."""
    return sqrt(v @ v)


def nearness(e: Array, angle: float, distance: float) -> Scalar:
    """Return 1 / (1 + (turn / angle)^2 + (shift / distance)^2) of a pose error (6,), which is 1 at zero error."""
    return 1.0 / (1.0 + (e[:3] @ e[:3]) / angle**2 + (e[3:] @ e[3:]) / distance**2)


def internal_force(chain: ClosedChain, state: State, wrenches: Array, length: float) -> Scalar:
    """Return the largest internal wrench of any grasp [N].

    The size of a wrench is sqrt(|moment / L|^2 + |force|^2) of f - f_motion, see `forces.split`.

    Args:
        chain: the chain with its closed grasps.
        state: its state.
        wrenches: (arms, 6) wrench of each arm on the object about its contact, world axes.
        length: L, see `moment_length` [m].
    """
    if len(chain.grasps) < 2:
        return 0.0
    places = contact_places(chain, state)
    offsets, rows = [place.offset for place in places], [chain.names.index(name) for name in chain.grasps]
    net = sum((shift_wrench(o, wrenches[i]) for i, o in zip(rows, offsets, strict=True)), start=np.zeros(6))
    internal = wrenches[rows] - motion_wrenches(places, net, length)
    largest = 0.0
    for f in internal:
        largest = maximum(largest, size(concatenate([f[:3] / length, f[3:]])))
    return largest


def moment_length(chain: ClosedChain) -> float:
    """Return the length that converts moments to forces: the rms distance of the contacts from their centroid [m]."""
    return length_scale([grasp.frame.p for grasp in chain.grasps.values()])


def excess(force: Scalar, largest: float) -> Scalar:
    """Return the amount by which a force exceeds a bound, relative to the bound; 0 below it."""
    return maximum(force / largest - 1.0, 0.0)


def in_object_axes(state: State, wrenches: Array) -> Array:
    """Return wrenches about the contacts in the object's axes, as one vector (6 k,)."""
    return concatenate([unrotate(state.object_frame.R, f) for f in wrenches])


def effort(action: Array) -> Scalar:
    """Return the mean square of an action's entries, clipped."""
    a = clipped(action)
    return (a @ a) / len(a)


def bounded(parts: Mapping[str, Array], bounds: Mapping[str, Array]) -> Array:
    """Return the parts of an observation as one vector, each clipped to +- its bounds."""
    assert list(parts) == list(bounds)
    every = [minimum(maximum(array(x), -bounds[name]), bounds[name]) for name, x in parts.items()]
    return concatenate(every)


def joint_bounds(chain: ClosedChain) -> dict[str, Array]:
    """Return bounds of observed joint positions and rates: the limits or, without one, 2 pi, 10 m, 10 rad/s or m/s."""
    limits = joint_limits(chain)
    q = [_farthest(joint, *ends) for joint, *ends in zip(chain.all_joints, limits.low, limits.high, strict=True)]
    return {"q": np.array(q), "qd": np.where(np.isfinite(limits.rate), limits.rate, OBSERVED_RATE)}


def _farthest(joint: Joint, low: float, high: float) -> float:
    """Return the bound of the observed position of one joint."""
    end = max(abs(low), abs(high))
    return float(end) if np.isfinite(end) else 2 * np.pi if joint.turns else OBSERVED_SLIDE


def pose_bounds() -> Array:
    """Return bounds of a pose error, (6,) [rad, m]."""
    return np.repeat([OBSERVED_TURN, OBSERVED_SHIFT], 3)
