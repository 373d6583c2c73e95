"""Control laws that turn a policy's action into joint torques; their parameter `action` is constant in a control step.

Every entry of an action is clipped to [-1, 1].
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from holdfast.control.computed_torque import computed_torque
from holdfast.control.controller import ControlLaw
from holdfast.control.grasp_forces import commanded_wrenches
from holdfast.control.gravity_compensation import GravityCompensation
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.fingerprint import exact_fingerprint
from holdfast.spatial.scalar import Array, Scalar, maximum, minimum
from holdfast.state import State


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
