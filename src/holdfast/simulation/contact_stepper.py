"""Steps of a chain whose object touches the world, in fixed modes: every stage has the contacts' forces."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from holdfast.dynamics.contact.fixed_modes import ContactModes, on_contacts, touch_at
from holdfast.dynamics.contact.sliding_hands import with_contact_wrench
from holdfast.dynamics.projection import largest_gaps
from holdfast.simulation.accounts import accounts_of
from holdfast.simulation.environment import inputs_at
from holdfast.simulation.instant import Instant, evaluate
from holdfast.simulation.linearly_implicit import Implicit
from holdfast.simulation.step import EvaluationRequest, Gaps, ProjectionRequest, StageRequest, back_on_constraint
from holdfast.simulation.stepper import NO_GAPS, ReferenceStepper
from holdfast.spatial.frozen import NOT_GIVEN
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State

TOUCH_WRENCH = "touch_wrench"  # its name among the arrays of an instant


@dataclass(frozen=True, eq=False)
class ContactStepper(ReferenceStepper):
    """Takes steps on floats in fixed modes; their ends are projected onto grasps and closed contacts.

    Attributes:
        modes: what the contacts do, with slip directions at the start of the stretch.
    """

    modes: ContactModes = NOT_GIVEN

    def start(self, t: float, state: State, memory: Any) -> tuple[Instant, Gaps]:
        """Return the chain at a given state; see `Stepper`."""
        now, gaps = super().start(t, state, memory)
        closed = on_contacts(now.chain, now.state, self.modes, now.result.held)
        return self.evaluate(t, closed, memory), gaps

    def accounts(self, t: Array, arrays: Mapping[str, Array]) -> dict[str, Array]:
        """Return what a run records besides the motion; see `Accounting`."""
        found = []
        for k in range(len(t)):

            def inputs(at: float, state: State, k: int = k) -> Inputs:
                own = inputs_at(self.environment.inputs, self.environment.of_state, at, state)
                wrench = arrays[TOUCH_WRENCH][k]
                return with_contact_wrench(self.environment.chain, state, own, self.modes.hands, wrench)

            found.append(accounts_of(replace(self.environment, inputs=inputs), t[k : k + 1], _row(arrays, k)))
        return {name: np.concatenate([one[name] for one in found]) for name in found[0]}

    def _reply(self, request: EvaluationRequest, now: Instant) -> Any:
        """Return the reply to a request of a step from `now`, whose slip directions hold for the step."""
        held, modes = now.result.held, self.modes if now.touch is None else now.touch.modes
        if isinstance(request, ProjectionRequest):
            chain, inputs = self.environment.at(request.t, request.state)
            state, gaps = request.state, NO_GAPS
            if chain.grasps:
                state, gaps = back_on_constraint(self.environment, request.t, request.state, held)
            closed = on_contacts(chain, state, replace(modes, begins=frozenset()), held)
            if modes.begins:  # their slip turns into its direction at the step's end
                touch = self._in_modes(request.t, closed, now.memory, held, modes).touch
                assert touch is not None
                closed = on_contacts(chain, closed, replace(touch.modes, begins=modes.begins), held)
            if not chain.grasps:
                return closed, gaps
            after = largest_gaps(chain, closed, inputs.shaped(chain))
            both = (gaps.position[0], after.position), (gaps.velocity[0], after.velocity)
            return closed, Gaps(*(np.array(pair) for pair in both))
        until = request.until if isinstance(request, StageRequest) else request.t
        modes = modes if now.touch is None else now.touch.modes_within(until - now.t)
        if isinstance(request, StageRequest):
            at = self._in_modes(request.t, request.state, now.memory, held, modes, request.implicit)
            return at.rates(request.turns)
        return self._in_modes(request.t, request.state, now.memory, None, modes)

    def _evaluated(
        self, t: float, state: State, memory: Any, held: Array | None, implicit: Implicit | None = None
    ) -> Instant:
        return self._in_modes(t, state, memory, held, self.modes, implicit)

    def _in_modes(
        self,
        t: float,
        state: State,
        memory: Any,
        held: Array | None,
        modes: ContactModes,
        implicit: Implicit | None = None,
    ) -> Instant:
        of = self.environment, self.controller, t, state, memory
        return evaluate(
            *of, generic_rank=self.generic_rank, held=held, implicit=implicit, contacts=partial(touch_at, modes=modes)
        )


def _row(arrays: Mapping[str, Array], k: int) -> dict[str, Array]:
    return {name: x[k : k + 1] for name, x in arrays.items()}
