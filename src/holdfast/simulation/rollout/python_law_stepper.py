"""The stepper for whole steps in machine code under a controller that is a Python function, called once a stage.

At points inside a step that ends elsewhere, the controller is not called: its torques there are those of the quadratic
through the torques at the start, in the middle and at the end of the step. They serve to see whether margins may need
a closer look, for which it is called.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import numpy as np

from holdfast.compiled.structure import Options
from holdfast.control.controller import Controller, torques_and_memory
from holdfast.errors import HoldfastError, StateError
from holdfast.model import checks
from holdfast.questions.arrays import state_of
from holdfast.simulation.environment import Environment
from holdfast.simulation.instant import Instant
from holdfast.simulation.rollout.fused_stepper import FusedStepper
from holdfast.simulation.rollout.kernel import StepKernel, Systems
from holdfast.simulation.rollout.rows import refuse
from holdfast.simulation.rollout.stage_torques import ASKED, GIVEN_TORQUES, asked_states, stage_torques
from holdfast.simulation.rollout.successive_steps import CarriedArrays, Driven
from holdfast.simulation.runge_kutta import Tableau
from holdfast.simulation.stepper import NO_GAPS, Advance
from holdfast.spatial.scalar import Array
from holdfast.state import State

LONGEST_AHEAD = 0.25  # s that a controller may take for steps together, so that progress is shown
OF_LAW = f"control.{GIVEN_TORQUES}"  # name of the torques in machine code
# functions of time [s] and state, or before these of the memory, that return the torques (n,) and the memory
Ask = Callable[[float, State], tuple[Array, Any]]
AskWithMemory = Callable[[Any, float, State], tuple[Array, Any]]


@dataclass(frozen=True, eq=False)
class PythonLawStepper(FusedStepper):
    """Takes whole steps in machine code under any controller, with traceable base motions and constant wrenches.

    Attributes:
        controller: the controller.
    """

    controller: Controller = field(kw_only=True)

    @classmethod
    def of_controller(
        cls, environment: Environment, controller: Controller, scheme: Tableau, generic_rank: int
    ) -> PythonLawStepper:
        """Return the stepper for a controller; the scheme must be explicit, and not adaptive."""
        chain, stages = environment.chain, len(scheme.c)
        law, options = stage_torques(chain, stages), Options(stages=stages)
        motions = environment.base_motion
        kernel = StepKernel(chain, law, scheme, generic_rank, motions=motions, options=options, quick=True)
        return cls(environment, kernel, scheme, generic_rank, controller=controller)

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return the results of single steps; see `Stepper`."""
        return [self.screened(now, [end])[0] for end in ends]

    def screened(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return the same, but the controller is called for the last step only; see the head of this file."""
        systems = self.start_of(now, len(ends))
        try:
            start = self._asking.numbers_of({name: x[:1] for name, x in systems.items()})
            torques, memory = self._asking.torques(start, now.t, ends[-1], now.tau, partial(self._ask, now.memory))
        except HoldfastError as cause:
            return [Advance(end, None, NO_GAPS, np.zeros(4), failure=cause) for end in ends]
        given = {OF_LAW: _at_points(torques, now.tau, np.array(ends) - now.t, self.scheme)}
        return self._advanced(systems, now.t, ends, given, memory)

    def _asked(
        self, systems: Systems, inputs: dict[str, Array], memory: Any, project: bool, evaluate: bool
    ) -> tuple[dict[str, Array], list[Any]]:
        times, at = inputs["begin"].tolist(), systems
        torques = np.zeros((len(times), len(self.scheme.c), self.environment.chain.joint_count))
        given = {OF_LAW: torques}
        if not evaluate:
            return given, [memory] * len(times)
        if project:
            at = {name: x.copy() for name, x in systems.items()}
            self.kernel.run(at, inputs | given, {})
            refuse(at)
        kept = []
        for row, t in enumerate(times):
            torques[row], later = self._ask(memory, t, state_of(at, row))
            kept.append(later)
        return given, kept

    def _driven(self, now: Instant, times: Array) -> Driven:
        return _CalledAhead(self._asking, self._ask, self.scheme, times, now.memory)

    def _ask(self, memory: Any, t: float, state: State) -> tuple[Array, Any]:
        """Return the torques of the controller, and its memory.

        Raises:
            StateError: the torques have a wrong shape, or are not finite.
        """
        tau, kept = torques_and_memory(self.controller(t, state, memory))
        return checks.numbers(tau, (len(state.q),), "controller: torques", StateError), kept

    @cached_property
    def _asking(self) -> StageByStage:
        return StageByStage(self.kernel, self.scheme, self._given)


class StageByStage:
    """Asks a controller for the torques at the stages of a step, one after another."""

    def __init__(self, kernel: StepKernel, scheme: Tableau, given: dict[str, Array]) -> None:
        self._arrays, self._nodes = CarriedArrays(kernel, 1, 1), scheme.c[1:].tolist()
        self._arrays.prepare({**given, "held": np.array(0.0)}, np.zeros(1), np.zeros((1, 1)))
        self._states = asked_states(kernel.chain, self._arrays.arrays[ASKED])
        self._numbers, self._torques = self._arrays.arrays[ASKED][0, 0], self._arrays.torques[0, 0]

    def numbers_of(self, system: Systems) -> Array:
        """Return the numbers of one system, (size,)."""
        return self._arrays.of_system(system)

    def torques(self, start: Array, begin: float, end: float, first: Array, ask: Ask) -> tuple[Array, Any]:
        """Return the torques (stages, n) at the later stages and at the step's end, and the memory from there.

        Args:
            start: (size,) the numbers of the system at the step's start.
            begin: the step's start [s].
            end: its end [s].
            first: (n,) the torques at its start.
            ask: returns torques and memory at a time and state.

        Raises:
            StateError: a stage is not finite, or what `ask` raises.
        """
        length, memory = end - begin, None
        self._arrays.set_step(begin, length)
        self._torques[...] = first
        times = [*(begin + node * length for node in self._nodes), end]
        for i, t in enumerate(times):
            self._arrays.block[0, 0] = start
            self._arrays.run(0)
            if not np.isfinite(self._numbers[i]).all():
                raise StateError("the step overflows float64; try a smaller time step")
            self._torques[i:], memory = ask(t, state_of(self._states, (0, 0, i)))
        return self._torques.copy(), memory


class _CalledAhead:
    """Sets the torques of successive steps by calls of a controller; see `successive_steps.Driven`."""

    def __init__(self, asking: StageByStage, ask: AskWithMemory, scheme: Tableau, times: Array, memory: Any) -> None:
        self._asking, self._ask, self._scheme, self._times, self._memory = asking, ask, scheme, times, memory
        self.memories: tuple[dict[int, Any], dict[int, Any]] = {}, {}
        self.interruption: BaseException | None = None
        self._begun = time.monotonic()

    def start(self, k: int, starts: CarriedArrays) -> bool:
        try:
            found, self._memory = self._ask(self._memory, float(self._times[k, 0]), state_of(starts.arrays, (k, 0)))
        except (Exception, KeyboardInterrupt) as cause:
            return self._failed(cause)
        starts.torques[k], self.memories[0][k] = found, self._memory
        return True

    def step(self, k: int, ends: CarriedArrays) -> bool:
        if k > 0 and time.monotonic() - self._begun > LONGEST_AHEAD:
            return False
        begin, *_, end = self._times[k].tolist()
        first, ask = ends.arrays["drive"][k, -1].copy(), partial(self._ask, self._memory)
        try:
            found, self._memory = self._asking.torques(ends.block[k, -1], begin, end, first, ask)
        except (Exception, KeyboardInterrupt) as cause:
            return self._failed(cause)
        ends.torques[k] = _at_points(found, first, self._times[k, 1:] - begin, self._scheme)
        self.memories[1][k] = self._memory
        return True

    def _failed(self, cause: BaseException) -> bool:
        """Keep an interruption, which ends the run after the steps before; an error is raised again by the step."""
        self.interruption = None if isinstance(cause, Exception) else cause
        return False


def _at_points(torques: Array, first: Array, lengths: Array, scheme: Tableau) -> Array:
    """Return the torques (points, stages, n) of the steps to several points, of which the last has those given.

    Args:
        torques: (stages, n) torques of the last step at its stages after the first, and at its end.
        first: (n,) torques at the start.
        lengths: (points,) lengths of the steps [s].
        scheme: the scheme.
    """
    nodes, end = np.append(scheme.c[1:], 1.0), torques[-1]
    middle = [torques[i] for i, node in enumerate(nodes[:-1]) if node == 0.5]
    half = sum(middle[1:], middle[0]) / len(middle) if middle else 0.5 * (first + end)
    u = (lengths / lengths[-1])[:, None, None] * nodes[:, None]
    found = (1.0 - u) * (1.0 - 2.0 * u) * first + 4.0 * u * (1.0 - u) * half + u * (2.0 * u - 1.0) * end
    found[-1] = torques
    return found
