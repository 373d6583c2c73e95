"""One evaluation of the simulated chain: control, joint friction, forward dynamics, power."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.control.controller import Controller, torques_and_memory
from holdfast.dynamics.energy import power
from holdfast.dynamics.forward import forward_dynamics
from holdfast.dynamics.result import ForwardResult
from holdfast.errors import SingularChainError, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.balance import work_rates
from holdfast.simulation.environment import Environment
from holdfast.simulation.increment import increment_rate, twists
from holdfast.simulation.linearly_implicit import Implicit, Passive, with_armature
from holdfast.spatial.scalar import Array, array, sqrt
from holdfast.state import Inputs, State

# Rate at which friction has reached 71 % of its size. A sign function has no slope that a
# fixed step could follow, and none of its solutions sticks exactly either way.
SMOOTHING_RATE = 0.05  # rad/s or m/s


def joint_friction(chain: ClosedChain) -> Array:
    """Return the joints' Coulomb friction F_c, (n,) [N m or N]."""
    return np.array([joint.friction for joint in chain.all_joints])


def friction_torque(size: Array, qd: Array) -> Array:
    """Return what friction takes from the drives' torques, F_c qd / sqrt(qd^2 + 0.05^2), (n,) [N m or N]."""
    return array([F * v / sqrt(v * v + SMOOTHING_RATE**2) for F, v in zip(size, qd, strict=True)])


def friction_slope(size: Array, qd: Array) -> Array:
    """Return d(friction torque)/d(qd), (n,) [N m s/rad or N s/m]; at standstill F_c / 0.05."""
    squares = [v * v + SMOOTHING_RATE**2 for v in qd]
    return array([F * SMOOTHING_RATE**2 / (x * sqrt(x)) for F, x in zip(size, squares, strict=True)])


def passive_at(chain: ClosedChain, qd: Array) -> Passive:
    """Return what dampers, friction and springs take from the joints, at joint rates (n,)."""
    damping, stiffness = np.array([(joint.damping, joint.stiffness) for joint in chain.all_joints]).reshape(-1, 2).T
    friction = joint_friction(chain)
    return Passive(damping + friction_slope(friction, qd) if friction.any() else damping, stiffness)


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

    @property
    def joints(self) -> tuple[Array, Array, Array]:
        """Joint positions, joint rates, and torques, (n,) each."""
        return self.state.q, self.state.qd, self.tau

    @property
    def velocities(self) -> Array:
        """(n + 6,) joint rates, and the object's twist; six more of a floating base."""
        return velocities(self.state)

    @property
    def accelerations(self) -> Array:
        """(n + 6,) of the joints, and of the object; six more of a floating base."""
        found, of_base = self.result, self.result.base_acceleration
        return np.concatenate([found.qdd, found.object_acceleration, *([] if of_base is None else [of_base])])

    def rates(self, turns: Sequence[Array]) -> Array:
        """Return d/dt of an `increment`.

        Args:
            turns: (3,) u of each free body since the step's start [rad].
        """
        found = self.result
        accelerations = (found.object_acceleration, found.base_acceleration)
        return increment_rate(self.state, found.qdd, accelerations, self.power, turns)


class LateInstant(Instant):
    """An instant that is put together when it is first asked for more than its time and its joints.

    Most instants inside a step are looked at for the margins of their joints alone.
    """

    def __getattr__(self, name: str) -> Any:
        """Return an attribute that is not there yet."""
        if name not in Instant.__dataclass_fields__:
            raise AttributeError(f"'{type(self).__name__}' object has no attribute '{name}'")
        vars(self).update(vars(self._whole()))
        return vars(self)[name]

    @property
    def joints(self) -> tuple[Array, Array, Array]:
        """Joint positions, joint rates, and torques, (n,) each."""
        return self._joints


def late_instant(t: float, joints: tuple[Array, Array, Array], whole: Callable[[], Instant]) -> Instant:
    """Return an instant that `whole` puts together when need be.

    Args:
        t: time [s].
        joints: positions, rates and torques, (n,) each.
        whole: returns the instant.
    """
    made = object.__new__(LateInstant)
    vars(made).update({"t": t, "_joints": joints, "_whole": whole})
    return made


def velocities(state: State) -> Array:
    """Return joint rates, the object's twist and that of a floating base, (n + 6,) or (n + 12,)."""
    return np.concatenate([state.qd, *twists(state)])


def evaluate(
    environment: Environment,
    controller: Controller,
    t: float,
    state: State,
    memory: Any,
    *,
    generic_rank: int | None = None,
    held: Array | None = None,
    check: bool = False,
    implicit: Implicit | None = None,
) -> Instant:
    """Return the chain at one time and state.

    Args:
        environment: the chain and what acts on it.
        controller: torques.
        t: time [s].
        state: positions and velocities.
        memory: the controller's.
        generic_rank: as for `forward_dynamics`.
        held: as for `forward_dynamics`.
        check: refuse a state that breaks the grasps.
        implicit: what forward dynamics differs by in a stage of a linearly implicit step.

    Raises:
        SingularChainError: the constraint's rank drops, or its condition passes 1e12.
        StateError: torques of a wrong shape, or not finite.
    """
    chain, inputs = environment.at(t, state)
    tau, memory = torques_and_memory(controller(t, state, memory))
    tau = checks.numbers(tau, (chain.joint_count,), "controller: torques", StateError)
    friction = friction_torque(joint_friction(chain), state.qd)
    net, solved = tau - friction, chain
    if implicit is not None:
        net, solved = net + implicit.torque, with_armature(chain, implicit.armature)
    found = forward_dynamics(solved, state, net, inputs=inputs, check=check, generic_rank=generic_rank, held=held)
    if not found.condition <= WORST_CONDITION:
        raise SingularChainError(
            f"the grasp constraint is nearly singular: condition {found.condition:.3g}, expected <="
            f" {WORST_CONDITION:g}; try another configuration or another grasp"
        )
    powers = work_rates(power(chain, state, tau, found, inputs), friction, state.qd)
    return Instant(t, state, chain, inputs, tau, memory, found, powers)
