"""Steps with impulses of contacts in machine code, for `simulate`; see `impulse_step`.

Impulses are found without a start, so that a step depends on its own state alone, and then in the surer ways of
rollouts, see `contact_steps`. Steps that machine code does not solve are taken by the reference.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from holdfast.compiled.structure import Options
from holdfast.control.controller import ControlLaw, Controller
from holdfast.control.traced_law import law_of
from holdfast.dynamics.contact.fixed_modes import ContactModes
from holdfast.errors import HoldfastError
from holdfast.questions.arrays import state_of
from holdfast.simulation.adaptive import Tolerance
from holdfast.simulation.contact_stepper import TOUCH_WRENCH, ContactStepper
from holdfast.simulation.environment import Environment
from holdfast.simulation.impulse_step import PASSES
from holdfast.simulation.impulse_stepper import ImpulseStepper, touch_with_rows
from holdfast.simulation.instant import Instant
from holdfast.simulation.rollout.between_steps import ACCOUNTS
from holdfast.simulation.rollout.called_functions import CalledFunctions, StageByStage
from holdfast.simulation.rollout.compiled_steppers import STEPS_WORTH_COMPILING, acting_at_first, move_bases
from holdfast.simulation.rollout.contact_stages import responses_of
from holdfast.simulation.rollout.contact_steps import SHORTEST_PART, TakeSteps, with_impulses
from holdfast.simulation.rollout.fused_stepper import (
    by_name,
    constant_inputs,
    hold_rows,
    options_for,
    shared_inputs,
    systems_at,
)
from holdfast.simulation.rollout.kernel import StepKernel, Systems
from holdfast.simulation.rollout.rows import StageInputs, gaps_of, instant_of, late, state_rows
from holdfast.simulation.rollout.stage_values import VALUES, acting_on, with_stage_values, wrench_arrays
from holdfast.simulation.rollout.systems import RolloutSystems
from holdfast.simulation.rollout.traced_impulses import FROM_LAST, LONG_WAY, WHOLE_PATH
from holdfast.simulation.runge_kutta import MIDPOINT, Tableau
from holdfast.simulation.stepper import Advance
from holdfast.spatial.frozen import NOT_GIVEN, changed
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs


@dataclass(frozen=True, eq=False)
class CompiledImpulseStepper(ImpulseStepper):
    """Takes steps with impulses by machine code, for laws that can be traced and constant wrenches.

    Attributes:
        kernels: the compiled step in each way of `traced_impulses` to find impulses.
    """

    kernels: Mapping[str, StepKernel] = NOT_GIVEN

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return the results of single steps; see `Stepper`."""
        return self._advanced(now, ends, self._take, lambda: now.memory)

    def _advanced(
        self, now: Instant, ends: Sequence[float], take: TakeSteps, memory: Callable[[], Any]
    ) -> list[Advance]:
        """Return the results of steps that `take` takes; `memory` returns that of the controller at their ends."""
        kernel, to = self.kernels[WHOLE_PATH], np.array(ends)
        arrays = kernel.systems(state_rows([now.state] * len(to)), now.memory)
        arrays["drive"][...] = now.tau
        hold_rows(arrays, now.result.held)
        systems = RolloutSystems(kernel.chain, arrays, np.full(len(to), now.t), to - now.t)
        with_impulses(systems, 1, take, WHOLE_PATH)
        kernel.choose_forces(arrays, self._inputs(to, np.array(0.0)), {})
        return [
            self._reached(arrays, row, end, memory())
            if on
            else super(CompiledImpulseStepper, self).advance(now, [end])[0]
            for row, (end, on) in enumerate(zip(ends, systems.running, strict=True))
        ]

    def _take(
        self, systems: RolloutSystems, h: Array, *, way: str, steps: int = 1, given: Mapping[str, Array] | None = None
    ) -> None:
        """Take steps in place, see `TakeSteps`; `given` are inputs of the law."""
        systems.set_step_length(h)
        self.kernels[way].run(systems.arrays, {**self._inputs(systems.begin, h), **(given or {})}, {}, steps)

    def _inputs(self, begin: Array, step: Array) -> dict[str, Array]:
        """Return the inputs of machine code for steps of given beginnings and lengths [s]."""
        return {**self._given, "begin": begin, "step": step, "held": np.array(0.0)}

    def _reached(self, systems: Systems, row: int, end: float, memory: Any) -> Advance:
        """Return the result of one system's step."""
        chain = self.environment.chain_at(end)

        def whole() -> Instant:
            acting = self._acting_at(end, systems, row)
            inputs = changed(acting, object_wrench=acting.object_wrench + systems[TOUCH_WRENCH][row])
            at = instant_of(systems, row, StageInputs(end, chain, inputs, None, memory))
            mode, rows = systems["touch_mode"][row].astype(int), responses_of(self.environment.chain).rows(at.state)
            return replace(at, touch=touch_with_rows(rows, at.state, systems["touch_force"][row], mode))

        instant = late(systems, row, end, chain, systems["drive"][row], whole, touches=True)
        return Advance(end, instant, gaps_of(systems, row), systems["work"][row].copy())

    def accounts(self, t: Array, arrays: Mapping[str, Array]) -> dict[str, Array]:
        """Return what a run records besides the motion; see `Accounting`."""
        kernel = self.kernels[WHOLE_PATH]
        systems, taken = systems_at(kernel, arrays), acting_on(kernel.chain, kernel.structure.options)
        acting = [wrench_arrays(taken, self._acting_at(at, systems, row)) for row, at in enumerate(t.tolist())]
        given = {name: np.stack([one[name] for one in acting]) for name in taken}
        given["object_wrench"] = given["object_wrench"] + arrays[TOUCH_WRENCH]
        return kernel.ask(ACCOUNTS, systems, {**self._inputs(t, np.array(0.0)), **given}, {})

    @cached_property
    def _given(self) -> dict[str, Array]:
        """The inputs that all steps share."""
        return shared_inputs(self.kernels[WHOLE_PATH], self._acting, by_name(getattr(self.controller, "values", {})))

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
        memory, ask, unused = now.memory, partial(self.functions.ask, now.memory), np.zeros(1)

        def take(systems: RolloutSystems, h: Array, *, way: str, steps: int = 1) -> None:
            nonlocal memory
            systems.begin, systems.arrays["count"][...] = systems.t, 0.0
            begin, asking = float(systems.begin[0]), self._asking(way)
            to = begin + float(h[0])
            to = end if end - to < SHORTEST_PART * h[0] else to  # the functions know the very end
            # torques at the start do not enter the step
            values, memory = asking.values(asking.numbers_of(systems.arrays), begin, to, unused, ask)
            self._take(systems, h, way=way, steps=steps, given={f"control.{VALUES}": values})

        try:
            return self._advanced(now, [end], take, lambda: memory)[0]
        except HoldfastError:  # the reference says why, if it has no answer either
            return super(CompiledImpulseStepper, self).advance(now, [end])[0]

    def _acting_at(self, t: float, systems: Systems, row: int) -> Inputs:
        return self.functions.wrenches(t, state_of(systems, row)) if self.functions.varying else self._acting

    @cached_property
    def _made(self) -> dict[str, StageByStage]:
        return {}

    def _asking(self, way: str) -> StageByStage:
        if way not in self._made:  # which compiles the step
            self._made[way] = StageByStage(self.kernels[way], [0.5] * PASSES, self._given)
        return self._made[way]


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
    law, options = law_of(controller, chain), options_for(environment)

    def kernels(law: ControlLaw, options: Options) -> dict[str, StepKernel]:
        of_way = partial(StepKernel, chain, law, MIDPOINT, generic_rank, quick=True)
        return {way: of_way(options=replace(options, contacts=way)) for way in (WHOLE_PATH, FROM_LAST, LONG_WAY)}

    if law is not None and constant:
        return CompiledImpulseStepper(*of, kernels(law, options))
    options = replace(options, stages=PASSES + 1)
    functions = CalledFunctions(environment, controller if law is None else None, options)
    given = with_stage_values(law, chain, options.stages, functions.varying)
    return CalledImpulseStepper(*of, kernels(given, options), functions)
