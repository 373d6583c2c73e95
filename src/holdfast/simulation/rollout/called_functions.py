"""Python functions whose values steps in machine code are given at their stages; see `stage_values`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from holdfast.compiled.structure import Options
from holdfast.compiler.program import Shape
from holdfast.control.controller import Controller, torques_and_memory
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.questions.arrays import state_of
from holdfast.simulation.environment import Environment, inputs_at, require_wrenches
from holdfast.simulation.rollout.kernel import StepKernel, Systems
from holdfast.simulation.rollout.stage_values import ASKED, acting_on, asked_states, wrench_arrays
from holdfast.simulation.rollout.successive_steps import CarriedArrays
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State

# function of time [s] and state that returns the values and the memory
Ask = Callable[[float, State], tuple[Array, Any]]


@dataclass(frozen=True, eq=False)
class CalledFunctions:
    """A controller, external wrenches, or both. Values are torques (n,), then wrenches.

    Attributes:
        environment: the chain and its external inputs.
        controller: the controller; None if a law in machine code gives the torques.
        options: options of the machine code.
    """

    environment: Environment
    controller: Controller | None
    options: Options

    @cached_property
    def varying(self) -> Mapping[str, Shape]:
        """The shapes of the external wrenches that are a function, by name."""
        return varying(self.environment, self.options)

    def ask(self, memory: Any, t: float, state: State) -> tuple[Array, Any]:
        """Return the values at a time [s] and state, and the memory of the controller.

        Raises:
            StateError: torques or wrenches have a wrong shape, or are not finite; the wrenches contain base motions.
        """
        acting = self.wrenches(t, state) if self.varying else Inputs()
        if self.controller is None:
            return self.values(np.zeros(0), acting), memory
        tau, kept = torques_and_memory(self.controller(t, state, memory))
        return self.values(checks.numbers(tau, (len(state.q),), "controller: torques", StateError), acting), kept

    def values(self, tau: Array, acting: Inputs) -> Array:
        """Return the values for torques and wrenches, of which only those that are not known otherwise are used."""
        torques = [] if self.controller is None else [tau]
        return np.concatenate([*torques, *(x.ravel() for x in wrench_arrays(self.varying, acting).values())])

    def wrenches(self, t: float, state: State) -> Inputs:
        """Return the external wrenches at a time and state."""
        found = inputs_at(self.environment.inputs, self.environment.of_state, t, state)
        require_wrenches(found, "of a function that gave none at t = 0")
        return found.shaped(self.environment.chain)


def varying(environment: Environment, options: Options) -> Mapping[str, Shape]:
    """Return the shapes of the external wrenches that are a function, by name."""
    return acting_on(environment.chain, options) if callable(environment.inputs) else {}


class StageByStage:
    """Asks functions for the values at the stages of a step, one after another.

    Args:
        kernel: the compiled step.
        nodes: the stages after the step's start, as parts of its length.
        given: inputs of all steps.
    """

    def __init__(self, kernel: StepKernel, nodes: list[float], given: dict[str, Array]) -> None:
        self._arrays, self._nodes = CarriedArrays(kernel, 1, 1), nodes
        self._arrays.prepare({**given, "held": np.array(0.0)}, np.zeros(1), np.zeros((1, 1)))
        self._states = asked_states(kernel.chain, self._arrays.arrays[ASKED])
        self._numbers, self._values = self._arrays.arrays[ASKED][0, 0], self._arrays.values[0, 0]

    def numbers_of(self, system: Systems) -> Array:
        """Return the numbers of one system, (size,)."""
        return self._arrays.of_system(system)

    def values(self, start: Array, begin: float, end: float, first: Array, ask: Ask) -> tuple[Array, Any]:
        """Return the values (stages, size) at the later stages and at the step's end, and the memory from there.

        Args:
            start: (size,) the numbers of the system at the step's start.
            begin: the step's start [s].
            end: its end [s].
            first: (size,) the values at its start.
            ask: returns values and memory at a time and state.

        Raises:
            StateError: a stage is not finite, or what `ask` raises.
        """
        length, memory = end - begin, None
        self._arrays.set_step(begin, length)
        self._values[...] = first
        times = [*(begin + node * length for node in self._nodes), end]
        for i, t in enumerate(times):
            self._arrays.block[0, 0] = start
            self._arrays.run(0)
            if not np.isfinite(self._numbers[i]).all():
                raise StateError("the step overflows float64; try a smaller time step")
            self._values[i:], memory = ask(t, state_of(self._states, (0, 0, i)))
        return self._values.copy(), memory
