"""The traced step of a system whose contacts with the world keep their modes; see `ContactStepper`.

The modes are numbers that systems carry, so that one step serves all of them. A system whose contact forces take
decisions keeps its state, with a status code that says so.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from holdfast.compiled.forward_schedule import SolutionWithStatus
from holdfast.compiled.traced_chain import Given, framed, traced_chain, traced_inputs
from holdfast.compiler.program import Shape
from holdfast.dynamics.closed.chain_motion import chain_at_rest
from holdfast.dynamics.closed.chain_solution import ChainSolution
from holdfast.dynamics.closed.sequential import tips_of
from holdfast.dynamics.contact.masked_modes import (
    ForcesInModes,
    MaskedModes,
    forces_in_modes,
    gap_closing,
    slip_removing,
)
from holdfast.dynamics.contact.rows import ContactRows, contact_rows
from holdfast.dynamics.contact.touching_chain import chain_mobility, push_response
from holdfast.dynamics.projection import displaced_by, largest_gaps, quickened
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import state_fields
from holdfast.simulation.contact_stepper import TOUCH_WRENCH
from holdfast.simulation.environment import Environment
from holdfast.simulation.rollout.traced_step import StepModel, TracedSystem, step_of
from holdfast.simulation.runge_kutta import Tableau
from holdfast.simulation.step import EvaluationRequest, ProjectionRequest
from holdfast.spatial.frozen import changed
from holdfast.spatial.scalar import Array, Scalar, array, maximum, select, where
from holdfast.spatial.vector import largest
from holdfast.state import Inputs, State

IN_MODES = "modes"  # `Options.contacts`
ROUNDS_ON_CONTACTS = 2  # of Newton's method, to close gaps at the step's end
LEFT_GAP, LEFT_SPEED = 1e-14, 1e-12  # m, m/s: what they may leave at closed contacts


def carried_in_modes(chain: ClosedChain) -> dict[str, Shape]:
    """Return the shapes of the arrays that systems carry besides those of every touching chain, by name.

    They are the forces in contact axes, the directions of slip, `Touch.slip_speed`, `stops_in` and `turning_time`, and
    `ForcesInModes.shared`.
    """
    assert chain.touching is not None
    k = len(chain.touching.candidates)
    of_each = dict.fromkeys(("touch_push", "touch_slip"), (k, 3)) | dict.fromkeys(("touch_speed", "touch_stops"), (k,))
    return of_each | {"touch_turning": (), "touch_shared": ()}


class SystemInModes(TracedSystem):
    """One system during the tracing of a step in fixed modes."""

    def __init__(self, model: StepModel, given: Given) -> None:
        chain = changed(traced_chain(model.structure, given), touching=model.structure.chain.touching)
        super().__init__(model, given, Environment(chain, {}, traced_inputs(chain, given)))
        self.modes = MaskedModes.of(self.last("touch_mode"))
        self.pushed: Array = np.zeros(6)

    def solve(
        self, chain: ClosedChain, state: State, tau: Array, inputs: Inputs, held: Array | None, choose: bool
    ) -> SolutionWithStatus:
        """Return forward dynamics with the forces of the closed contacts."""
        state = framed(state)
        free = super().solve(chain, state, tau, inputs, held, choose)
        still = chain_at_rest(chain, state)
        rows = _rows(chain, state)
        of = rows, chain_mobility(still, tips_of(still)), state.object_twist, free.whole.object_acceleration
        found = forces_in_modes(*of, self.modes, self.last("touch_slip"))
        self._enter(rows, found)
        return super().solve(chain, state, tau, self._with_push(inputs), held, choose)

    def power(
        self, chain: ClosedChain, state: State, drive: Array, lost: Array, inputs: Inputs, whole: ChainSolution
    ) -> Array:
        """Return the power (4,), with that of the contacts."""
        return super().power(chain, state, drive, lost, self._with_push(inputs), whole)

    def handle(self, request: EvaluationRequest) -> Any:
        """Return the reply to a request of a step; its end is projected onto the closed contacts as well."""
        reply = super().handle(request)
        if not isinstance(request, ProjectionRequest):
            return reply
        state, (drift, _) = reply
        chain, inputs = self.environment.at(request.t, state)
        self.end, still = None, self.given["held"][()] > 0.5
        closed = self._on_contacts(chain, state)
        fields = state_fields(self.real).values()
        kept = State(**{one: select(still, getattr(state, one), getattr(closed, one)) for one in fields})
        return kept, [drift, largest_gaps(chain, kept, inputs)]

    def _on_contacts(self, chain: ClosedChain, state: State) -> State:
        """Return the state moved onto the closed contacts; see `fixed_modes.on_contacts`."""
        response = push_response(chain_at_rest(chain, state), state)
        for _ in range(ROUNDS_ON_CONTACTS):
            push = gap_closing(_rows(chain, state), response.mobility, self.modes)
            state = displaced_by(state, response.change(push))
        rows, response = _rows(chain, state), push_response(chain_at_rest(chain, state), state)
        self._require(largest(self.modes.closed * rows.gap) <= LEFT_GAP)
        push, left = slip_removing(rows, response.mobility, state.object_twist, self.modes)
        self._require(left <= LEFT_SPEED)
        return quickened(state, response.change(push))

    def _require(self, lawful: Scalar) -> None:
        self.unlawful = maximum(self.unlawful, where(lawful, 0.0, 1.0))

    def _enter(self, rows: ContactRows, found: ForcesInModes) -> None:
        self._require(found.lawful > 0.5)
        self.pushed = found.wrench
        self.touches = {
            "touch_force": rows.in_world(found.force),
            "touch_gap": rows.gap,
            "touch_mode": self.last("touch_mode"),
            TOUCH_WRENCH: found.wrench,
            "touch_push": found.force,
            "touch_slip": found.slip,
            "touch_speed": found.speed,
            "touch_stops": found.stops_in,
            "touch_turning": array(found.turning_time),
            "touch_shared": array(found.shared),
        }

    def _with_push(self, inputs: Inputs) -> Inputs:
        return changed(inputs, object_wrench=inputs.object_wrench + self.pushed)


def step(model: StepModel, tableau: Tableau, given: Given) -> dict[str, Any]:
    """Return the carried arrays of a system after a step in fixed modes; a system that stops keeps its last state."""
    return step_of(SystemInModes(model, given), tableau)


def _rows(chain: ClosedChain, state: State) -> ContactRows:
    assert chain.touching is not None
    return contact_rows(chain.touching, state.object_frame, state.object_twist)
