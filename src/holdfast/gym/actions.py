"""What actions drive: control laws whose parameter `action` is a policy's choice, held for a control step.

Every entry lies in [-1, 1]; what is beyond is clipped.
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
    chain: ClosedChain, acceleration: Array, squeeze: float, squeeze_span: float, joint_damping: float
) -> ControlLaw:
    """Return the law that gives the object an acceleration while the arms squeeze it; 7 actions.

    alpha = acceleration * a[:6], squeeze + squeeze_span * a[6]: computed torque for the chain as it is modelled.

    Args:
        chain: as the controller knows it.
        acceleration: (6,) largest [omega_dot; v_dot] of C, world axes [rad/s^2, m/s^2].
        squeeze: of every arm along its contact normal at a[6] = 0 [N].
        squeeze_span: what a[6] = 1 adds [N].
        joint_damping: of the joint motion that no grasp feels [1/s].
    """

    def torque(t: Scalar, now: State, memory: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
        a = clipped(given["action"])
        alpha = acceleration * a[:6]
        wrenches = commanded_wrenches(chain, now, alpha, squeeze + squeeze_span * a[6])
        return computed_torque(chain, now, alpha, wrenches, joint_damping), memory

    return _keyed(torque, 7, chain, acceleration, squeeze, squeeze_span, joint_damping)


def joint_law(chain: ClosedChain, torque: Array, squeeze: float, joint_damping: float) -> ControlLaw:
    """Return the law that carries the weight, slows joints down and adds torques; n actions.

    tau = `GravityCompensation(chain, squeeze, joint_damping)` + torque * a.

    Args:
        chain: as the controller knows it.
        torque: (n,) largest torques of an action [N m or N].
        squeeze: of every arm along its contact normal [N].
        joint_damping: d, of tau = -d qd [N m s/rad or N s/m].

    Raises:
        MethodNotApplicable: a trunk whose base floats under gravity.
    """
    weightless = GravityCompensation(chain, squeeze, joint_damping)

    def law(t: Scalar, now: State, memory: Array, given: Mapping[str, Array]) -> tuple[Array, Array]:
        tau, _ = weightless(t, now, None)
        return tau + torque * clipped(given["action"]), memory

    return _keyed(law, chain.joint_count, chain, torque, squeeze, joint_damping)


def clipped(action: Array) -> Array:
    """Return actions within [-1, 1]."""
    return minimum(maximum(action, -1.0), 1.0)


def _keyed(law: Callable[..., Any], size: int, *numbers: Any) -> ControlLaw:
    """Return a law of `action` (size,), found again on disk by its text and its numbers where these tell all."""
    known = exact_fingerprint(list(numbers))
    source = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()
    key = f"{law.__qualname__}/{known}/{source}" if known else ""
    return ControlLaw(law, parameters={"action": (size,)}, key=key)
