"""The traced step of a system whose object may touch the world; see `impulse_step`, which is its text.

Impulses are found by a fixed number of steps: from the forces of the step before, which the system carries ("warm");
without them ("cold"), at five times the operations; or so, but with more of Newton's steps ("longer"). A system whose
impulses violate the laws keeps its state, with a status code that says so.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from holdfast.compiled.traced_chain import Given, framed, traced_chain, traced_inputs
from holdfast.control.sampled import within_steps
from holdfast.dynamics.contact.contact_forces import RESOLVED, FoundForces
from holdfast.dynamics.contact.pressing import forces_of_near
from holdfast.dynamics.contact.proximal_newton import COMPLIANCES
from holdfast.dynamics.projection import LEFT_OPEN, Change, after_step
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import state_fields
from holdfast.simulation.contact_stepper import TOUCH_WRENCH
from holdfast.simulation.environment import Environment
from holdfast.simulation.impulse_step import ImpulseProblem, impulse_step
from holdfast.simulation.rollout.stage_values import SystemWithStageValues
from holdfast.simulation.rollout.traced_step import StepModel, TracedSystem, step_of
from holdfast.simulation.rollout.user_functions import checked_motion
from holdfast.simulation.runge_kutta import Tableau
from holdfast.simulation.step import StepResult
from holdfast.spatial.frozen import changed
from holdfast.spatial.scalar import Array, Scalar, maximum, select, where
from holdfast.state import Inputs, State

FROM_LAST, WHOLE_PATH, LONG_WAY = "warm", "cold", "longer"  # how impulses are found
# of Newton's steps at the path's end: contacts that hardly slip beside others that stick need as many, and all stiff
# ones, as softer ones lead away from what the path has found
STIFF = (1e-4,) * 8


class TouchingSystem(TracedSystem):
    """One system during the tracing of a step with impulses; it answers what the step asks, see `SteppedChain`."""

    def __init__(self, model: StepModel, given: Given) -> None:
        chain = changed(traced_chain(model.structure, given), touching=model.structure.chain.touching)
        moving = {name: checked_motion(name, motion) for name, motion in model.motions.items()}
        super().__init__(model, given, Environment(chain, moving, traced_inputs(chain, given)))
        self.way = model.structure.options.contacts
        self.pushed: Array = np.zeros(6)
        self.finite: Scalar = 0.0

    def at(self, t: Scalar, state: State) -> tuple[ClosedChain, Inputs]:
        """Return the chain at a time [s], and its inputs."""
        return self.environment.at(t, state)

    def surroundings(self, t: Scalar, state: State) -> tuple[ClosedChain, Inputs]:
        """Return the chain and its inputs, among them the wrench of contacts at the step's end."""
        chain, inputs = super().surroundings(t, state)
        return chain, changed(inputs, object_wrench=inputs.object_wrench + self.pushed)

    def on_grasps(self, t: Scalar, state: State) -> State:
        """Return a state projected onto the grasps."""
        if not self.real.grasps:
            return state
        return after_step(*self._chain_state(t, state), self.held).state

    def _chain_state(self, t: Scalar, state: State) -> tuple[ClosedChain, State, Inputs]:
        chain, inputs = self.at(t, state)
        return chain, state, inputs

    def accelerated(self, t: Scalar, state: State) -> tuple[Change, Array]:
        """Return the accelerations and the power without contacts."""
        self.conditions.clear()  # both passes have one configuration
        now = self.evaluate(t, state, self.last("memory"), False, law=within_steps(self.law))
        whole = now.found.whole
        self.finite = self.finite + sum(abs(x) for x in (*whole.qdd, *whole.object_acceleration))
        return Change(whole.qdd, whole.object_acceleration, whole.base_acceleration), now.power

    def resolve(self, problem: ImpulseProblem) -> FoundForces:
        """Return impulses by a fixed number of steps."""
        start = problem.start if self.way == FROM_LAST else None
        slide = np.zeros((len(problem.rows.gap), 2))
        of = problem.mobility, problem.rows, problem.free, slide, problem.near
        return forces_of_near(*of, start, STIFF if self.way == LONG_WAY else COMPLIANCES)

    def step_from(self, tableau: Tableau, first: Array) -> StepResult:
        """Return the result of a step; if the input `held` is set, the state is not changed."""
        given, before = self.given, self.state
        h = given["step"][()]
        found = impulse_step(self, before, self.time(0.0), h, self.last("touch_force"))
        still = given["held"][()] > 0.5
        fields = state_fields(self.real)
        end = State(
            **{field: select(still, self.last(name), getattr(found.state, field)) for name, field in fields.items()}
        )
        force = found.rows.in_world(found.force)
        self.pushed = found.rows.wrench(found.force)
        deepest = found.rows.gap[0]
        for gap in found.rows.gap[1:]:
            deepest = where(gap < deepest, gap, deepest)
        lawful = where(found.residual <= RESOLVED, where(deepest >= -LEFT_OPEN, 1.0, 0.0), 0.0)
        excused = maximum(lawful, where(h > 0.0, 0.0, 1.0))  # a start that penetrates has no contacts yet
        self.unlawful = where(self.finite < float("inf"), 1.0 - excused, 0.0)  # inputs may be what is wrong
        self.touches = {"touch_force": force, "touch_gap": found.rows.gap, "touch_mode": found.mode}
        self.touches[TOUCH_WRENCH] = self.pushed
        end = framed(end)
        later = self.evaluate(self.time(1.0), end, self.last("memory"), True, self.added)
        return StepResult(later, [found.drift, found.gaps], found.work, [])


class TouchingSystemWithStageValues(TouchingSystem, SystemWithStageValues):
    """The same with given torques and wrenches: in both passes, and at the step's end."""


def step(model: StepModel, tableau: Tableau, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the carried arrays of a system after a step with impulses; a system that stops keeps its last state."""
    if model.structure.options.stages:
        return TouchingSystemWithStageValues(model, given).step(tableau)
    return step_of(TouchingSystem(model, given), tableau)
