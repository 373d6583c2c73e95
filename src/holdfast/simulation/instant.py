"""Evaluation of the simulated chain at one instant: control, joint friction, forward dynamics and power."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from holdfast.control.controller import Controller, torques_and_memory
from holdfast.dynamics.contact.fixed_modes import Touch
from holdfast.dynamics.contact.sliding_hands import with_contact_wrench
from holdfast.dynamics.energy import power
from holdfast.dynamics.forward import forward_dynamics
from holdfast.dynamics.result import ForwardResult
from holdfast.errors import SingularChainError, StateError
from holdfast.forces.margins import grasp_margins
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.balance import work_rates
from holdfast.simulation.environment import Environment
from holdfast.simulation.increment import increment_rate, twists
from holdfast.simulation.joint_friction import friction_torque, joint_friction
from holdfast.simulation.linearly_implicit import Implicit, with_armature
from holdfast.spatial.frozen import changed
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State

ContactsAt = Callable[[ClosedChain, State, ForwardResult], Touch]  # of chain, state, motion without contact forces
WORST_CONDITION = 1e12  # beyond it the grasp forces have no significant digit


@dataclass(frozen=True, eq=False)
class Instant:
    """The chain at one time, with its controls, accelerations and powers.

    Attributes:
        t: time [s].
        state: positions and velocities.
        chain: the chain, with its bases at their poses at time t.
        inputs: external wrenches and base motion at time t.
        tau: (n,) torques of the controller.
        memory: the memory that the controller has returned.
        result: result of forward dynamics.
        power: (4,) in the order of `balance.WORK_TERMS` [W].
        touch: the contacts with the world, whose forces are among the inputs; None without any.
    """

    t: float
    state: State
    chain: ClosedChain
    inputs: Inputs
    tau: Array
    memory: Any
    result: ForwardResult
    power: Array
    touch: Touch | None = field(default_factory=lambda: None)  # of no class, where `LateInstant` would find it

    @property
    def joints(self) -> tuple[Array, Array, Array]:
        """Joint positions, joint rates, and torques, (n,) each."""
        return self.state.q, self.state.qd, self.tau

    @property
    def grasp_margins(self) -> Array:
        """(grasps,) margins of the grasps with the forces of the result [N]."""
        return grasp_margins(self.chain, self.state, self.result.grasp_wrench)

    @property
    def grasp_wrenches(self) -> Array:
        """(grasps, 6) wrenches at the grasps; of a chain that is answered as a forest, at its closures."""
        return self.result.grasp_wrench

    @property
    def velocities(self) -> Array:
        """(n + 6,) joint rates and the object's twist; a floating base adds six entries."""
        return np.concatenate([self.state.qd, *twists(self.state)])

    @property
    def accelerations(self) -> Array:
        """(n + 6,) accelerations of the joints and of the object; a floating base adds six entries."""
        found, of_base = self.result, self.result.base_acceleration
        return np.concatenate([found.qdd, found.object_acceleration, *([] if of_base is None else [of_base])])

    def rates(self, turns: Sequence[Array]) -> Array:
        """Return the time derivative of an `increment`.

        Args:
            turns: (3,) rotation vector u of each free body relative to the step's start [rad].
        """
        return increment_rate(self.state, self.result, self.power, turns)


class LateInstant(Instant):
    """An instant that is evaluated in full only when an attribute other than its time and joints is first used.

    For most instants inside a step only the margins of the joints are needed.
    """

    def __getattr__(self, name: str) -> Any:
        """Evaluate the instant in full, and return the attribute."""
        if name.startswith("_"):
            raise AttributeError(f"'{type(self).__name__}' object has no attribute '{name}'")
        found = getattr(self._evaluated, name)
        vars(self).update({**vars(self._evaluated), name: found})
        return found

    @cached_property
    def _evaluated(self) -> Instant:
        return self._whole()

    @property
    def joints(self) -> tuple[Array, Array, Array]:
        """Joint positions, joint rates, and torques, (n,) each."""
        return self._joints

    @property
    def grasp_margins(self) -> Array:
        """(grasps,) margins of the grasps with the forces of the result [N]."""
        return super().grasp_margins if self._margins is None else self._margins

    @property
    def grasp_wrenches(self) -> Array:
        """(grasps, 6) wrenches at the grasps."""
        return self._evaluated.grasp_wrenches


def late_instant(
    t: float,
    joints: tuple[Array, Array, Array],
    margins: Array | None,
    whole: Callable[[], Instant],
    touches: bool = False,
) -> Instant:
    """Return an instant that is evaluated in full by `whole` when this is needed.

    Args:
        t: time [s].
        joints: positions, rates and torques, (n,) each.
        margins: (grasps,) margins of the grasps; None if they have to be computed.
        whole: returns the fully evaluated instant.
        touches: whether that has contacts with the world.
    """
    made = object.__new__(LateInstant)
    vars(made).update({"t": t, "_joints": joints, "_margins": margins, "_whole": whole})
    if not touches:
        vars(made)["touch"] = None
    return made


def evaluate(
    environment: Environment,
    controller: Controller,
    t: float,
    state: State,
    memory: Any,
    *,
    generic_rank: int | None = None,
    held: Array | None = None,
    implicit: Implicit | None = None,
    contacts: ContactsAt | None = None,
) -> Instant:
    """Return the chain at one time and state.

    Args:
        environment: the chain, its base motions and external inputs.
        controller: the controller that returns the torques.
        t: time [s].
        state: positions and velocities.
        memory: the memory to pass to the controller.
        generic_rank: as for `forward_dynamics`.
        held: as for `forward_dynamics`.
        implicit: additional armatures and torques in a stage of a linearly implicit step.
        contacts: returns the contacts with the world and their forces; None without any.

    Raises:
        SingularChainError: the constraint loses rank, or its condition number exceeds 1e12.
        StateError: the torques have a wrong shape, or are not finite.
    """
    chain, inputs = environment.at(t, state)
    tau, memory = torques_and_memory(controller(t, state, memory))
    tau = checks.numbers(tau, (chain.joint_count,), "controller: torques", StateError)
    friction = friction_torque(joint_friction(chain), state.qd)
    net, solved = tau - friction, chain
    if implicit is not None:
        net, solved = net + implicit.torque, with_armature(chain, implicit.armature)
    how: Any = {"check": False, "generic_rank": generic_rank, "held": held}
    solved = changed(solved, touching=None)  # contacts act by their modes
    found, touch = forward_dynamics(solved, state, net, inputs=inputs, **how), None
    if contacts is not None:
        touch = contacts(chain, state, found)
        inputs = with_contact_wrench(chain, state, inputs, touch.modes.hands, touch.rows.wrench(touch.force))
        if touch.force.any():
            found = forward_dynamics(solved, state, net, inputs=inputs, **how)
    if not found.condition <= WORST_CONDITION:
        raise SingularChainError(
            f"the grasp constraint is nearly singular: condition {found.condition:.3g}, expected <="
            f" {WORST_CONDITION:g}; try another configuration or another grasp"
        )
    powers = work_rates(power(chain, state, tau, found, inputs), friction, state.qd)
    return Instant(t, state, chain, inputs, tau, memory, found, powers, touch)
