"""Steps whose controller and base motions are part of the machine code: several ends cost about as much as one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.simulation.environment import Environment
from holdfast.simulation.instant import Instant
from holdfast.simulation.rollout.kernel import StepKernel, Systems
from holdfast.simulation.rollout.law import ControlLaw
from holdfast.simulation.rollout.rows import failure, gaps_of, instant_of, state_rows
from holdfast.simulation.runge_kutta import Tableau
from holdfast.simulation.step import Gaps
from holdfast.simulation.stepper import NO_GAPS, Advance
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State


@dataclass(frozen=True, eq=False)
class FusedStepper:
    """Steps of a chain under a control law, base motions traceable, external wrenches constant; see `Stepper`.

    Attributes:
        environment: the chain and what acts on it.
        kernel: its step.
        scheme: the Runge-Kutta scheme of its steps; it estimates no errors.
        generic_rank: rank of the constraint away from singular configurations.
    """

    environment: Environment
    kernel: StepKernel
    scheme: Tableau
    generic_rank: int

    @classmethod
    def of(cls, environment: Environment, law: ControlLaw, scheme: Tableau, generic_rank: int) -> FusedStepper:
        """Return the stepper of a law."""
        kernel = StepKernel(environment.chain, law, scheme, generic_rank, motions=environment.base_motion, quick=True)
        return cls(environment, kernel, scheme, generic_rank)

    def start(self, t: float, state: State, memory: Any) -> tuple[Instant, Gaps]:
        """Return the chain at a given state, projected onto the grasps; see `Stepper`."""
        return self._at(t, state, memory, held=False)

    def evaluate(self, t: float, state: State, memory: Any) -> Instant:
        """Return the chain at a given state, taken as it is."""
        return self._at(t, state, memory, held=True)[0]

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return where one step leads; see `Stepper`."""
        systems = self.kernel.systems(state_rows([now.state] * len(ends)), self._flat(now.memory))
        systems["slope"][...] = now.rates(np.zeros(3))
        self._run(systems, now.t, np.array(ends) - now.t, held=False)
        return [self._advance(systems, row, end, now.memory) for row, end in enumerate(ends)]

    def _advance(self, systems: Systems, row: int, end: float, memory: Any) -> Advance:
        fault = failure(systems["code"][row])
        if fault is not None:
            return Advance(end, None, NO_GAPS, np.zeros(4), failure=fault)
        instant = self._instant(systems, row, end, memory)
        return Advance(end, instant, gaps_of(systems, row), systems["work"][row].copy())

    def _at(self, t: float, state: State, memory: Any, held: bool) -> tuple[Instant, Gaps]:
        systems = self.kernel.systems(state_rows([state]), self._flat(memory))
        self._run(systems, t, np.zeros(1), held)
        fault = failure(systems["code"][0])
        if fault is not None:
            raise fault
        return self._instant(systems, 0, t, memory), gaps_of(systems, 0)

    def _run(self, systems: Systems, begin: float, steps: Array, held: bool) -> None:
        acting = self.environment.inputs
        assert isinstance(acting, Inputs)
        inputs = {
            "begin": np.array(begin),
            "step": steps,
            "held": np.array(float(held)),
            "object_wrench": acting.shaped(self.environment.chain).object_wrench,
        }
        self.kernel.run(systems, inputs, {}, 1, 1)

    def _instant(self, systems: Systems, row: int, t: float, memory: Any) -> Instant:
        tau = systems["drive"][row].copy()
        kept = systems["memory"][row].copy() if "memory" in systems else memory
        chain, inputs = self.environment.at(t)
        return instant_of(systems, row, t, chain, inputs.shaped(chain), tau, kept, self.generic_rank)

    def _flat(self, memory: Any) -> Array | None:
        return memory if "memory" in self.kernel.carried else None
