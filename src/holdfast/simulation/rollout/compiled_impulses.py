"""Steps with impulses of contacts in machine code, for `simulate`; see `impulse_step`.

Impulses are found without a start, so that a step depends on its own state alone. Steps that machine code does not
solve are taken by the reference, which has more ways to find impulses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from holdfast.control.controller import Controller
from holdfast.control.traced_law import law_of
from holdfast.dynamics.contact.fixed_modes import ContactModes
from holdfast.simulation.adaptive import Tolerance
from holdfast.simulation.contact_stepper import TOUCH_WRENCH, ContactStepper
from holdfast.simulation.environment import Environment
from holdfast.simulation.impulse_stepper import ImpulseStepper, touch_of
from holdfast.simulation.instant import Instant
from holdfast.simulation.rollout.compiled_steppers import STEPS_WORTH_COMPILING, unsteady
from holdfast.simulation.rollout.fused_stepper import by_name, constant_inputs, hold_rows, options_for, shared_inputs
from holdfast.simulation.rollout.kernel import StepKernel, Systems
from holdfast.simulation.rollout.rows import StageInputs, gaps_of, instant_of, state_rows
from holdfast.simulation.rollout.traced_impulses import WHOLE_PATH
from holdfast.simulation.rollout.traced_step import RUNNING
from holdfast.simulation.runge_kutta import MIDPOINT, Tableau
from holdfast.simulation.stepper import Advance
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
        systems = self.kernel.systems(state_rows([now.state] * len(ends)), now.memory)
        systems["drive"][...] = now.tau
        hold_rows(systems, now.result.held)
        inputs = {**self._given, "begin": np.array(now.t), "step": np.array(ends) - now.t, "held": np.array(0.0)}
        self.kernel.run(systems, inputs, {})
        self.kernel.choose_forces(systems, {**inputs, "begin": np.array(ends), "step": np.array(0.0)}, {})
        return [
            self._reached(systems, row, end, now)
            if systems["code"][row] == RUNNING
            else super(CompiledImpulseStepper, self).advance(now, [end])[0]
            for row, end in enumerate(ends)
        ]

    def _reached(self, systems: Systems, row: int, end: float, now: Instant) -> Advance:
        """Return the result of one system's step."""
        inputs = changed(self._acting, object_wrench=self._acting.object_wrench + systems[TOUCH_WRENCH][row])
        chain = self.environment.chain_at(end)
        at = instant_of(systems, row, StageInputs(end, chain, inputs, None, now.memory))
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

    Machine code takes laws that can be traced and constant wrenches, where bases and shapes of the world stand still.

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
    law, touching = law_of(controller, chain), chain.touching
    stands = not environment.base_motion and not unsteady(environment.inputs)
    machine = touching is not None and not touching.without_machine_code and not modes.hands
    if law is None or not (stands and machine) or steps < STEPS_WORTH_COMPILING:
        return ImpulseStepper(*of)
    options = replace(options_for(environment), contacts=WHOLE_PATH)
    return CompiledImpulseStepper(*of, StepKernel(chain, law, MIDPOINT, generic_rank, options=options, quick=True))
