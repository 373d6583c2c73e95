"""Steps with impulses of contacts in machine code, for `simulate`; see `impulse_step`.

Impulses are found without a start, so that a step depends on its own state alone. Steps that machine code does not
solve are taken by the reference, which has more ways to find impulses.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from holdfast.control.controller import Controller
from holdfast.control.traced_law import law_of
from holdfast.dynamics.contact.fixed_modes import ContactModes
from holdfast.errors import HoldfastError
from holdfast.questions.arrays import state_of
from holdfast.simulation.adaptive import Tolerance
from holdfast.simulation.contact_stepper import TOUCH_WRENCH, ContactStepper
from holdfast.simulation.environment import Environment
from holdfast.simulation.impulse_step import PASSES
from holdfast.simulation.impulse_stepper import ImpulseStepper, touch_of
from holdfast.simulation.instant import Instant
from holdfast.simulation.rollout.called_functions import CalledFunctions, StageByStage
from holdfast.simulation.rollout.compiled_steppers import STEPS_WORTH_COMPILING, acting_at_first, move_bases
from holdfast.simulation.rollout.fused_stepper import by_name, constant_inputs, hold_rows, options_for, shared_inputs
from holdfast.simulation.rollout.kernel import StepKernel, Systems
from holdfast.simulation.rollout.rows import StageInputs, gaps_of, instant_of, state_rows
from holdfast.simulation.rollout.stage_values import VALUES, with_stage_values
from holdfast.simulation.rollout.traced_impulses import WHOLE_PATH
from holdfast.simulation.rollout.traced_step import RUNNING
from holdfast.simulation.runge_kutta import MIDPOINT, Tableau
from holdfast.simulation.stepper import NO_GAPS, Advance
from holdfast.spatial.frozen import NOT_GIVEN, changed
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs


@dataclass(frozen=True, eq=False)
class CompiledImpulseStepper(ImpulseStepper):
    """Takes steps with impulses by machine code, for laws that can be traced and constant wrenches.

    Attributes:
        kernel: the compiled step.
    """

    kernel: StepKernel = NOT_GIVEN

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return the results of single steps; see `Stepper`."""
        return self._advanced(self._start(now, len(ends)), now, ends, {}, now.memory)

    def _start(self, now: Instant, count: int) -> Systems:
        """Return a number of systems at the start of steps."""
        systems = self.kernel.systems(state_rows([now.state] * count), now.memory)
        systems["drive"][...] = now.tau
        hold_rows(systems, now.result.held)
        return systems

    def _advanced(
        self, systems: Systems, now: Instant, ends: Sequence[float], given: Mapping[str, Array], memory: Any
    ) -> list[Advance]:
        """Take steps in place, and return their results; `given` are inputs of the law, `memory` that at the ends."""
        inputs = {**self._given, "begin": np.array(now.t), "step": np.array(ends) - now.t, "held": np.array(0.0)}
        self.kernel.run(systems, {**inputs, **given}, {})
        self.kernel.choose_forces(systems, {**inputs, "begin": np.array(ends), "step": np.array(0.0)}, {})
        return [
            self._reached(systems, row, end, memory)
            if systems["code"][row] == RUNNING
            else super(CompiledImpulseStepper, self).advance(now, [end])[0]
            for row, end in enumerate(ends)
        ]

    def _reached(self, systems: Systems, row: int, end: float, memory: Any) -> Advance:
        """Return the result of one system's step."""
        acting = self._acting_at(end, systems, row)
        inputs = changed(acting, object_wrench=acting.object_wrench + systems[TOUCH_WRENCH][row])
        chain = self.environment.chain_at(end)
        at = instant_of(systems, row, StageInputs(end, chain, inputs, None, memory))
        mode = systems["touch_mode"][row].astype(int)
        touch = touch_of(systems["touch_force"][row], mode, chain, at.state, at.result)
        return Advance(end, replace(at, touch=touch), gaps_of(systems, row), systems["work"][row].copy())

    @cached_property
    def _given(self) -> dict[str, Array]:
        """The inputs that all steps share."""
        return shared_inputs(self.kernel, self._acting, by_name(getattr(self.controller, "values", {})))

    @cached_property
    def _acting(self) -> Inputs:
        return constant_inputs(self.environment)

    def _acting_at(self, t: float, systems: Systems, row: int) -> Inputs:
        """Return the wrenches at a step's end, without those of contacts."""
        return self._acting


@dataclass(frozen=True, eq=False)
class CalledImpulseStepper(CompiledImpulseStepper):
    """The same under Python functions: a controller, external wrenches, or both, which both passes and the end ask.

    Attributes:
        functions: the functions.
    """

    functions: CalledFunctions = NOT_GIVEN

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return the results of single steps; see `Stepper`."""
        return [self._called(now, end) for end in ends]

    def _called(self, now: Instant, end: float) -> Advance:
        systems, ask, unused = self._start(now, 1), partial(self.functions.ask, now.memory), np.zeros(1)
        try:  # torques at the start do not enter the step
            values, memory = self._asking.values(self._asking.numbers_of(systems), now.t, end, unused, ask)
        except HoldfastError as cause:
            return Advance(end, None, NO_GAPS, np.zeros(4), failure=cause)
        return self._advanced(systems, now, [end], {f"control.{VALUES}": values}, memory)[0]

    def _acting_at(self, t: float, systems: Systems, row: int) -> Inputs:
        return self.functions.wrenches(t, state_of(systems, row)) if self.functions.varying else self._acting

    @cached_property
    def _asking(self) -> StageByStage:
        return StageByStage(self.kernel, [0.5] * PASSES, self._given)


def impulse_stepper_for(
    environment: Environment,
    controller: Controller,
    generic_rank: int,
    scheme: Tableau,
    tolerance: Tolerance,
    modes: ContactModes,
    steps: int,
) -> ContactStepper:
    """Return the stepper for a run with impulses of contacts; the motions of both agree up to rounding.

    Machine code takes every controller and all wrenches, where bases and shapes of the world stand still.

    Args:
        environment: the chain, its base motions and external inputs.
        controller: the controller.
        generic_rank: rank of the constraint away from singular configurations.
        scheme: the scheme of the run, which steps with impulses do not use.
        tolerance: tolerance of adaptive schemes.
        modes: what the contacts do at the start.
        steps: the least number of steps that the run will take.
    """
    chain, of = environment.chain, (environment, controller, generic_rank, scheme, tolerance, modes)
    touching, constant = chain.touching, isinstance(environment.inputs, Inputs)
    moves = environment.base_motion or move_bases(acting_at_first(environment))
    machine = touching is not None and not touching.without_machine_code and not modes.hands
    if moves or not machine or steps < STEPS_WORTH_COMPILING:
        return ImpulseStepper(*of)
    law, options = law_of(controller, chain), replace(options_for(environment), contacts=WHOLE_PATH)
    kernel = partial(StepKernel, chain, tableau=MIDPOINT, generic_rank=generic_rank, quick=True)
    if law is not None and constant:
        return CompiledImpulseStepper(*of, kernel(law, options=options))
    options = replace(options, stages=PASSES + 1)
    functions = CalledFunctions(environment, controller if law is None else None, options)
    given = with_stage_values(law, chain, options.stages, functions.varying)
    return CalledImpulseStepper(*of, kernel(given, options=options), functions)
