"""One evaluation of the simulated chain: control, forward dynamics, power."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.forward import forward_dynamics
from holdfast.dynamics.result import ForwardResult
from holdfast.errors import ModelError, SingularChainError, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.balance import power_terms
from holdfast.simulation.environment import Environment
from holdfast.simulation.friction import friction_torque, joint_friction
from holdfast.simulation.runge_kutta import rotation_vector_rate
from holdfast.spatial.scalar import Array, concatenate
from holdfast.state import Inputs, State

# (t, state, memory) -> (torques (n,), memory): a pure function, memory None at the start
Controller = Callable[[float, State, Any], tuple[ArrayLike, Any]]

WORST_CONDITION = 1e12  # beyond it no digit of the grasp forces is left


@dataclass(frozen=True, eq=False)
class Instant:
    """The chain at one time, with everything that follows from its state.

    Attributes:
        t: time [s].
        state: positions and velocities.
        chain: the chain, its bases where they are now.
        inputs: external wrenches and base motion now.
        tau: (n,) torques of the controller.
        memory: what the controller carries on.
        result: forward dynamics.
        power: (4,) see `balance.WORK_TERMS` [W].
    """

    t: float
    state: State
    chain: ClosedChain
    inputs: Inputs
    tau: Array
    memory: Any
    result: ForwardResult
    power: Array

    def rates(self, turn: Array) -> Array:
        """Return d/dt of (q, qd, u, p, V(C), work), where exp(u) has brought the object here.

        Args:
            turn: (3,) u since the step's start [rad].
        """
        found = self.result
        return rates(self.state, found.qdd, found.object_acceleration, self.power, turn)


def rates(state: State, qdd: Array, acceleration: Array, power: Array, turn: Array) -> Array:
    """Return d/dt of (q, qd, u, p, V(C), work), (2 n + 16,); see `Instant.rates`.

    Args:
        state: positions and velocities.
        qdd: (n,) joint accelerations.
        acceleration: (6,) of C.
        power: (4,) [W].
        turn: (3,) u since the step's start [rad].
    """
    w, v = state.object_twist[:3], state.object_twist[3:]
    return concatenate([state.qd, qdd, rotation_vector_rate(turn, w), v, acceleration, power])


def require_controller(controller: Any) -> None:
    """Refuse what cannot be asked for torques.

    Raises:
        ModelError: it is no function.
    """
    if not callable(controller):
        raise ModelError(
            "controller: expected a function (t, state, memory) -> (torques, memory), got"
            f" {type(controller).__name__}; try lambda t, state, memory: (tau, memory), or a TorqueSchedule"
        )


def answer(found: Any) -> tuple[Any, Any]:
    """Return the torques and the memory that a controller returned.

    Raises:
        StateError: it returned something else.
    """
    if not isinstance(found, tuple) or len(found) != 2:
        got = f"an array of shape {found.shape}" if isinstance(found, np.ndarray) else f"a {type(found).__name__}"
        got = f"{len(found)} things" if isinstance(found, tuple) else got
        raise StateError(f"controller: expected it to return torques and memory, got {got}; try `return tau, memory`")
    return found


def evaluate(
    environment: Environment,
    controller: Controller,
    t: float,
    state: State,
    memory: Any,
    *,
    generic_rank: int | None = None,
    check: bool = False,
) -> Instant:
    """Return the chain at one time and state.

    Args:
        environment: the chain and what acts on it.
        controller: torques.
        t: time [s].
        state: positions and velocities.
        memory: the controller's.
        generic_rank: as for `forward_dynamics`.
        check: refuse a state that breaks the grasps.

    Raises:
        SingularChainError: the constraint's rank drops, or its condition passes 1e12.
        StateError: torques of a wrong shape, or not finite.
    """
    chain, inputs = environment.at(t)
    tau, memory = answer(controller(t, state, memory))
    tau = checks.numbers(tau, (chain.joint_count,), "controller: torques", StateError)
    friction = friction_torque(joint_friction(chain), state.qd)
    found = forward_dynamics(chain, state, tau - friction, inputs=inputs, check=check, generic_rank=generic_rank)
    if not found.condition <= WORST_CONDITION:
        raise SingularChainError(
            f"the grasp constraint is nearly singular: condition {found.condition:.3g}, expected <="
            f" {WORST_CONDITION:g}; try another posture or another grasp"
        )
    power = power_terms(chain, state, tau, friction, found, inputs)
    return Instant(t, state, chain, inputs, tau, memory, found, power)
