"""The stepper for whole steps in machine code under Python functions: a controller, external wrenches, or both.

They are called once a stage. At points inside a step that ends elsewhere, they are not called: torques and wrenches
there are those of the quadratic through the values at the start, in the middle and at the end of the step. They serve
to see whether margins may be negative there, which calls of the functions decide, and otherwise to find the lowest.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from holdfast.compiled.structure import Options
from holdfast.compiler.program import Shape
from holdfast.control.controller import ControlLaw, Controller, torques_and_memory
from holdfast.errors import HoldfastError, StateError
from holdfast.model import checks
from holdfast.questions.arrays import state_of
from holdfast.simulation.environment import Environment, inputs_at, require_wrenches
from holdfast.simulation.instant import Instant
from holdfast.simulation.interpolant import quadratic
from holdfast.simulation.rollout.between_steps import ACCOUNTS
from holdfast.simulation.rollout.fused_stepper import FusedStepper, by_name, options_for, systems_at
from holdfast.simulation.rollout.kernel import StepKernel, Systems
from holdfast.simulation.rollout.rows import refuse
from holdfast.simulation.rollout.stage_values import (
    ASKED,
    VALUES,
    acting_on,
    asked_states,
    with_stage_values,
    wrench_arrays,
)
from holdfast.simulation.rollout.successive_steps import CarriedArrays, Driven
from holdfast.simulation.runge_kutta import Tableau
from holdfast.simulation.stepper import NO_GAPS, Advance
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State

LONGEST_AHEAD = 0.25  # s that the functions may take for steps together, so that progress is shown
OF_LAW = f"control.{VALUES}"  # name of the values in machine code
# functions of time [s] and state, or before these of the memory, that return the values and the memory
Ask = Callable[[float, State], tuple[Array, Any]]
AskWithMemory = Callable[[Any, float, State], tuple[Array, Any]]


@dataclass(frozen=True, eq=False)
class PythonLawStepper(FusedStepper):
    """Takes whole steps in machine code under any controller and wrenches, with traceable base motions.

    Values are the torques (n,), if no law computes them, and the external wrenches, if they are a function.

    Attributes:
        controller: the controller; None if the kernel's law is traced.
    """

    controller: Controller | None = field(kw_only=True)

    @classmethod
    def of_controller(
        cls,
        environment: Environment,
        controller: Controller,
        scheme: Tableau,
        generic_rank: int,
        law: ControlLaw | None = None,
    ) -> PythonLawStepper:
        """Return the stepper for a controller; the scheme must be explicit, and not adaptive.

        Args:
            environment: the chain, its base motions and external inputs.
            controller: the controller.
            scheme: the Runge-Kutta scheme.
            generic_rank: rank of the constraint away from singular configurations.
            law: the law of the controller, if it can be traced.
        """
        chain, stages = environment.chain, len(scheme.c)
        options = replace(options_for(environment), stages=stages)
        given = with_stage_values(law, chain, stages, varying(environment, options))
        motions = environment.base_motion
        kernel = StepKernel(chain, given, scheme, generic_rank, motions=motions, options=options, quick=True)
        values = by_name({} if law is None else getattr(controller, "values", {}))
        return cls(environment, kernel, scheme, generic_rank, values, controller=controller if law is None else None)

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return the results of single steps; see `Stepper`."""
        return [self.screened(now, [end])[0] for end in ends]

    def screened(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return the same, but the controller is called for the last step only; see the head of this file."""
        systems = self.start_of(now, len(ends))
        try:
            start = self._asking.numbers_of({name: x[:1] for name, x in systems.items()})
            first = self._first(now)
            values, memory = self._asking.values(start, now.t, ends[-1], first, partial(self._ask, now.memory))
        except HoldfastError as cause:
            return [Advance(end, None, NO_GAPS, np.zeros(4), failure=cause) for end in ends]
        given = {OF_LAW: _at_points(values, first, np.array(ends) - now.t, self.scheme)}
        return self._advanced(systems, now.t, ends, given, memory)

    def _asked(
        self, systems: Systems, inputs: dict[str, Array], memory: Any, project: bool, evaluate: bool
    ) -> tuple[dict[str, Array], list[Any]]:
        times, at = inputs["begin"].tolist(), systems
        values = np.zeros((len(times), *self.kernel.law.parameters[VALUES]))
        given = {OF_LAW: values}
        if not evaluate:
            return given, [memory] * len(times)
        if project:
            at = {name: x.copy() for name, x in systems.items()}
            self.kernel.run(at, inputs | given, {})
            refuse(at)
        kept = []
        for row, t in enumerate(times):
            values[row], later = self._ask(memory, t, state_of(at, row))
            kept.append(later)
        return given, kept

    def _driven(self, now: Instant, times: Array) -> Driven:
        traced, first = self.controller is None, self._first(now)
        return _CalledAhead(self._asking, self._ask, self.scheme, times, first, None if traced else now.memory, traced)

    def _first(self, now: Instant) -> Array:
        """Return the values at an instant; inputs that are not used are not asked for, for that would evaluate it."""
        return self._values(now.tau, now.inputs if self._varying else self._acting)

    def _ask(self, memory: Any, t: float, state: State) -> tuple[Array, Any]:
        """Return the values at a time and state, and the memory of the controller.

        Raises:
            StateError: torques or wrenches have a wrong shape, or are not finite; the wrenches contain base motions.
        """
        acting = self._wrenches(t, state) if self._varying else self._acting
        if self.controller is None:
            return self._values(np.zeros(0), acting), memory
        tau, kept = torques_and_memory(self.controller(t, state, memory))
        return self._values(checks.numbers(tau, (len(state.q),), "controller: torques", StateError), acting), kept

    def _values(self, tau: Array, acting: Inputs) -> Array:
        """Return the values for torques and wrenches, of which only those that are not known otherwise are used."""
        torques = [] if self.controller is None else [tau]
        return np.concatenate([*torques, *(x.ravel() for x in wrench_arrays(self._varying, acting).values())])

    @cached_property
    def _varying(self) -> Mapping[str, Shape]:
        """The shapes of the external wrenches that are among the values."""
        return varying(self.environment, self.kernel.structure.options)

    def _wrenches(self, t: float, state: State) -> Inputs:
        """Return the external wrenches at a time and state."""
        found = inputs_at(self.environment.inputs, self.environment.of_state, t, state)
        require_wrenches(found, "of a function that gave none at t = 0")
        return found.shaped(self.environment.chain)

    def accounts(self, t: Array, arrays: Mapping[str, Array]) -> dict[str, Array]:
        """Return what a run records besides the motion; see `Accounting`."""
        if not self._varying:
            return super().accounts(t, arrays)
        systems = systems_at(self.kernel, arrays)
        found = [
            wrench_arrays(self._varying, self._wrenches(at, state_of(systems, row)))
            for row, at in enumerate(t.tolist())
        ]
        acting = {name: np.array([one[name] for one in found]) for name in found[0]}
        return self.kernel.ask(ACCOUNTS, systems, self._inputs(t, np.array(0.0), True) | acting, {})

    @cached_property
    def _asking(self) -> StageByStage:
        return StageByStage(self.kernel, self.scheme, self._given)


def varying(environment: Environment, options: Options) -> Mapping[str, Shape]:
    """Return the shapes of the external wrenches that are a function, by name."""
    return acting_on(environment.chain, options) if callable(environment.inputs) else {}


class StageByStage:
    """Asks functions for the values at the stages of a step, one after another."""

    def __init__(self, kernel: StepKernel, scheme: Tableau, given: dict[str, Array]) -> None:
        self._arrays, self._nodes = CarriedArrays(kernel, 1, 1), scheme.c[1:].tolist()
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


class _CalledAhead:
    """Sets the values of successive steps by calls of functions; see `successive_steps.Driven`.

    Args:
        asking: asks at the stages.
        ask: returns values and memory.
        scheme: the scheme.
        times: (k, points + 1) the steps' starts and their points [s].
        first: (size,) values at the first start.
        memory: memory of the controller there.
        traced: whether the memory is that of a traced law, which is part of the results.
    """

    def __init__(
        self,
        asking: StageByStage,
        ask: AskWithMemory,
        scheme: Tableau,
        times: Array,
        first: Array,
        memory: Any,
        traced: bool,
    ) -> None:
        self._asking, self._ask, self._scheme, self._times = asking, ask, scheme, times
        self._last, self.memory, self._known = first, memory, dict[int, tuple[Array, Array]]()
        self.memories: tuple[dict[int, Any], dict[int, Any]] | None = None if traced else ({}, {})
        self.interruption: BaseException | None = None
        self._begun = time.monotonic()

    def start(self, k: int, starts: CarriedArrays) -> bool:
        try:
            state = state_of(starts.arrays, (k, 0))
            self._last, self.memory = self._ask(self.memory, float(self._times[k, 0]), state)
        except (Exception, KeyboardInterrupt) as cause:
            return self._failed(cause)
        starts.values[k] = self._last
        return self._remember(0, k)

    def step(self, k: int, ends: CarriedArrays) -> bool:
        if k > 0 and time.monotonic() - self._begun > LONGEST_AHEAD:
            return False
        begin, *_, end = self._times[k].tolist()
        first, ask = self._last, partial(self._ask, self.memory)
        try:
            found, self.memory = self._asking.values(ends.block[k, -1], begin, end, first, ask)
        except (Exception, KeyboardInterrupt) as cause:
            return self._failed(cause)
        ends.values[k] = _at_points(found, first, self._times[k, 1:] - begin, self._scheme)
        self._last, self._known[k] = found[-1], (found, first)
        return self._remember(1, k)

    def inside(self, k: int, length: float) -> Array:
        whole = float(self._times[k, -1] - self._times[k, 0])
        return _at_points(*self._known[k], np.array([length, whole]), self._scheme)[0]

    def _remember(self, where: int, k: int) -> bool:
        if self.memories is not None:
            self.memories[where][k] = self.memory
        return True

    def _failed(self, cause: BaseException) -> bool:
        """Keep an interruption, which ends the run after the steps before; an error is raised again by the step."""
        self.interruption = None if isinstance(cause, Exception) else cause
        return False


def _at_points(values: Array, first: Array, lengths: Array, scheme: Tableau) -> Array:
    """Return the values (points, stages, size) of the steps to several points, of which the last has those given.

    Args:
        values: (stages, size) values of the last step at its stages after the first, and at its end.
        first: (size,) values at the start.
        lengths: (points,) lengths of the steps [s].
        scheme: the scheme.
    """
    nodes, end = np.append(scheme.c[1:], 1.0), values[-1]
    middle = [values[i] for i, node in enumerate(nodes[:-1]) if node == 0.5]
    half = sum(middle[1:], middle[0]) / len(middle) if middle else 0.5 * (first + end)
    u = (lengths / lengths[-1])[:, None, None] * nodes[:, None]
    found = quadratic(first, half, end, u)
    found[-1] = values
    return found
