"""The steppers of runs with contacts in fixed modes: while all are open, whole steps of the chain alone, with its gaps.

Otherwise every stage needs the forces of the closed contacts; see `contact_stages`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from holdfast.control.controller import Controller
from holdfast.control.traced_law import law_of
from holdfast.dynamics.contact.fixed_modes import ContactModes, Touch, touch_with
from holdfast.dynamics.contact.solved_contacts import ContactMode, ContactStatus
from holdfast.questions.arrays import state_of
from holdfast.simulation.adaptive import Tolerance
from holdfast.simulation.checkpoint import Origin
from holdfast.simulation.contact_stepper import TOUCH_WRENCH, ContactStepper
from holdfast.simulation.environment import Environment
from holdfast.simulation.instant import Instant
from holdfast.simulation.rollout.closed_contacts import ClosedContactStepper
from holdfast.simulation.rollout.compiled_steppers import worth_compiling
from holdfast.simulation.rollout.contact_stages import CompiledResponses, StagewiseContactStepper, responses_of
from holdfast.simulation.rollout.fused_stepper import FusedStepper, Taken
from holdfast.simulation.rollout.kernel import Systems
from holdfast.simulation.runge_kutta import Tableau
from holdfast.simulation.sample import HAND_WRENCH
from holdfast.simulation.stepper import Stepper
from holdfast.spatial.frozen import NOT_GIVEN
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State


@dataclass(frozen=True, eq=False)
class OpenContactStepper(FusedStepper):
    """Takes whole steps with open contacts, whose gaps are known at every point of a step.

    Attributes:
        modes: the modes, all of them open.
        responses: the chain's responses at rest.
    """

    modes: ContactModes = NOT_GIVEN
    responses: CompiledResponses = NOT_GIVEN

    def instant(self, systems: Systems, row: int, t: float, memory: Any) -> Instant:
        """Return one of several systems as an instant with its contacts; see `FusedStepper`."""
        made = super().instant(systems, row, t, memory)
        vars(made)["touch"] = self._touch(state_of(systems, row))
        return made

    def take(
        self,
        now: Instant,
        times: Array,
        jumps: Array,
        remember: Callable[[int, Systems], Array | None] | None,
    ) -> Taken:
        """Return the results of successive steps with their contacts; see `FusedStepper`."""
        found = super().take(now, times, jumps, remember)

        def again(steps: Any, lengths: Any) -> Systems:
            return self._with_contacts(found.again(steps, lengths))

        starts = self._with_contacts(found.starts) if jumps.any() else found.starts
        return found._replace(ends=self._with_contacts(found.ends), starts=starts, again=again)

    def accelerations(self, origin: Origin, state: State) -> Array:
        """Return the acceleration of the object without contact forces, (6,), at a time and with a memory."""
        return self.evaluate(origin.t, state, origin.memory).result.object_acceleration

    def _whole(self, systems: Systems, row: int, t: float, memory: Any) -> Instant:
        made = super()._whole(systems, row, t, memory)
        return replace(made, touch=self._touch(made.state))

    def _touch(self, state: State) -> Touch:
        """Return the open contacts at a state, which need no acceleration."""
        return touch_with(self.responses, state, np.zeros(6), self.modes)

    def _with_contacts(self, x: Mapping[str, Array]) -> Systems:
        """Return the arrays of systems (..., *shape) with the gaps of their open contacts."""
        return {**x, "touch_gap": self.responses.gaps_of(x["object_pose"], x["object_twist"])}

    def of_samples(self, x: Mapping[str, Array]) -> Systems:
        """Return what samples (k, ...) record of open contacts besides their gaps."""
        gap = x["touch_gap"]
        lead, k = gap.shape[:-1], gap.shape[-1]
        return {
            "touch_force": np.zeros((*lead, k, 3)),
            "touch_mode": np.full((*lead, k), ContactMode.OPEN.value),
            "touch_margin": np.full((*lead, k), np.inf),
            "touch_status": np.full(lead, [*ContactStatus].index(ContactStatus.OK)),
            TOUCH_WRENCH: np.zeros((*lead, 6)),
            HAND_WRENCH: np.zeros((*lead, len(self.environment.chain.arms), 6)),
        }


class ContactSteppers:
    """Makes the steppers of a run in fixed modes; see `MakeContactStepper`. Stretches in machine code share theirs."""

    def __init__(self, steps: int) -> None:
        """Begin without a stepper; `steps` is the least number of steps that the run will take."""
        self._steps, self._of = steps, tuple[Any, ...]()
        self._open: OpenContactStepper | None = None
        self._closed: ClosedContactStepper | None = None
        self._stages: StagewiseContactStepper | None = None

    def __call__(
        self,
        environment: Environment,
        controller: Controller,
        generic_rank: int,
        scheme: Tableau,
        tolerance: Tolerance,
        modes: ContactModes,
    ) -> Stepper:
        """Return the most suitable stepper for a stretch; the results of all steppers agree up to rounding.

        Machine code takes chains whose grasps are independent, that stand still, and in which nothing is elastic. It
        takes whole steps of runs that are long enough, under laws that can be traced, while no contact is closed.
        """
        of = environment, controller, generic_rank, scheme, tolerance
        chain = environment.chain
        if modes.hands or generic_rank != chain.constraint_row_count or not _in_machine_code(environment, scheme):
            return ContactStepper(*of, modes)
        if len(self._of) != len(of) or any(x is not y for x, y in zip(of, self._of, strict=True)):
            self._of, self._open, self._closed, self._stages = of, None, None, None
        law, responses = law_of(controller, chain), responses_of(chain)
        values = getattr(controller, "values", {})
        if law is not None and not len(modes.closed) and worth_compiling(chain, self._steps):
            if self._open is None:
                made = OpenContactStepper.of(environment, law, scheme, generic_rank, values, tolerance)
                self._open = replace(made, modes=modes, responses=responses)
            return self._open
        if self._stages is None:
            self._stages = StagewiseContactStepper(*of, law, modes, responses)
        stages = replace(self._stages, modes=modes)
        if law is None or not worth_compiling(chain, self._steps):
            return stages
        if self._closed is None:
            made = ClosedContactStepper.of(environment, law, scheme, generic_rank, values, tolerance)
            self._closed = replace(made, responses=responses)
        return self._closed.in_modes(modes, stages)


def _in_machine_code(environment: Environment, scheme: Tableau) -> bool:
    chain, inputs = environment.chain, environment.inputs
    elastic = chain.springs or chain.bushings or any(joint.stiffness for joint in chain.all_joints)
    plain = isinstance(inputs, Inputs) and all(x is None for name, x in vars(inputs).items() if name != "object_wrench")
    left_out = (
        chain.touching is None
        or chain.touching.without_machine_code
        or chain.floats
        or elastic
        or scheme.implicit
        or not plain
        or environment.base_motion
    )
    return not left_out
