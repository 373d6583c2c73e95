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

from holdfast.control.controller import ControlLaw, Controller
from holdfast.errors import HoldfastError
from holdfast.questions.arrays import state_of
from holdfast.simulation.environment import Environment
from holdfast.simulation.instant import Instant
from holdfast.simulation.interpolant import quadratic
from holdfast.simulation.rollout.between_steps import ACCOUNTS
from holdfast.simulation.rollout.called_functions import CalledFunctions, StageByStage, varying
from holdfast.simulation.rollout.fused_stepper import FusedStepper, by_name, options_for, systems_at
from holdfast.simulation.rollout.kernel import StepKernel, Systems
from holdfast.simulation.rollout.rows import refuse
from holdfast.simulation.rollout.stage_values import VALUES, with_stage_values, wrench_arrays
from holdfast.simulation.rollout.successive_steps import CarriedArrays, Driven
from holdfast.simulation.runge_kutta import Tableau
from holdfast.simulation.stepper import NO_GAPS, Advance
from holdfast.spatial.scalar import Array
from holdfast.state import State

LONGEST_AHEAD = 0.25  # s that the functions may take for steps together, so that progress is shown
OF_LAW = f"control.{VALUES}"  # name of the values in machine code
# function of memory, time [s] and state that returns the values and the memory
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
            ask = partial(self._functions.ask, now.memory)
            values, memory = self._asking.values(start, now.t, ends[-1], first, ask)
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
            values[row], later = self._functions.ask(memory, t, state_of(at, row))
            kept.append(later)
        return given, kept

    def _driven(self, now: Instant, times: Array) -> Driven:
        ask, first, traced = self._functions.ask, self._first(now), self.controller is None
        return _CalledAhead(self._asking, ask, self.scheme, times, first, None if traced else now.memory, traced)

    def _first(self, now: Instant) -> Array:
        """Return the values at an instant; inputs that are not used are not asked for, for that would evaluate it."""
        return self._functions.values(now.tau, now.inputs if self._functions.varying else self._acting)

    def accounts(self, t: Array, arrays: Mapping[str, Array]) -> dict[str, Array]:
        """Return what a run records besides the motion; see `Accounting`."""
        functions = self._functions
        if not functions.varying:
            return super().accounts(t, arrays)
        systems = systems_at(self.kernel, arrays)
        found = [
            wrench_arrays(functions.varying, functions.wrenches(at, state_of(systems, row)))
            for row, at in enumerate(t.tolist())
        ]
        acting = {name: np.array([one[name] for one in found]) for name in found[0]}
        return self.kernel.ask(ACCOUNTS, systems, self._inputs(t, np.array(0.0), True) | acting, {})

    @cached_property
    def _functions(self) -> CalledFunctions:
        return CalledFunctions(self.environment, self.controller, self.kernel.structure.options)

    @cached_property
    def _asking(self) -> StageByStage:
        return StageByStage(self.kernel, self.scheme.c[1:].tolist(), self._given)


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
