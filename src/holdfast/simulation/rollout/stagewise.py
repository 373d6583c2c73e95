"""Steps of any scheme in any environment, stage by stage: dynamics, projection and a traced law are machine code."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from holdfast.compiled.structure import Options
from holdfast.errors import HoldfastError, MethodNotApplicable, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.environment import Environment
from holdfast.simulation.instant import Controller, Instant, answer
from holdfast.simulation.rollout.kernel import StepKernel, Systems
from holdfast.simulation.rollout.law import ControlLaw, held_torques
from holdfast.simulation.rollout.rows import failure, gaps_of, instant_of, state_of, state_rows
from holdfast.simulation.runge_kutta import EULER, Tableau, rotation_vector_rate
from holdfast.simulation.step import Closing, Gaps, Question, Stage, answered_together, course_of
from holdfast.simulation.stepper import NO_GAPS, Advance
from holdfast.simulation.tolerance import Tolerance
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State


@dataclass(frozen=True, eq=False)
class Moment:
    """What a system is told from outside at one time.

    Attributes:
        t: time [s].
        chain: its bases where they are.
        inputs: shaped.
        tau: (n,) torques of the controller; None where they are machine code's.
        memory: what it carries on.
    """

    t: float
    chain: ClosedChain
    inputs: Inputs
    tau: Array | None
    memory: Any


@dataclass(frozen=True, eq=False)
class StagewiseStepper:
    """Steps that ask the environment from Python at every stage, and a controller that is no machine code; see `Stepper`.

    Attributes:
        environment: the chain and what acts on it; no wrenches on links.
        controller: torques; None where they are part of the kernel.
        kernel: a step, of which only the end is used: states closed, or evaluated.
        generic_rank: rank of the constraint away from singular configurations.
        scheme: the Runge-Kutta scheme.
        tolerance: what `Advance.error` compares the scheme's estimates with.
    """

    environment: Environment
    controller: Controller | None
    kernel: StepKernel
    generic_rank: int
    scheme: Tableau
    tolerance: Tolerance

    @classmethod
    def of(
        cls,
        environment: Environment,
        controller: Controller,
        generic_rank: int,
        scheme: Tableau,
        tolerance: Tolerance,
        law: ControlLaw | None = None,
    ) -> StagewiseStepper:
        """Return the stepper of a controller; a `law` that gives the same torques is asked in its place."""
        ours = held_torques(environment.chain.joint_count) if law is None else law
        options = Options(base_motion=moving(environment))
        kernel = StepKernel(environment.chain, ours, EULER, generic_rank, options=options, quick=True)
        return cls(environment, controller if law is None else None, kernel, generic_rank, scheme, tolerance)

    def start(self, t: float, state: State, memory: Any) -> tuple[Instant, Gaps]:
        """Return the chain at a given state, projected onto the grasps; see `Stepper`."""
        closed = self._run([t], [state], [self._still(t)], None, held=False)
        _refuse(closed)
        return self.evaluate(t, state_of(closed, 0), memory), gaps_of(closed, 0)

    def evaluate(self, t: float, state: State, memory: Any) -> Instant:
        """Return the chain at a given state, taken as it is."""
        found, moments = self._evaluated([t], [state], memory)
        _refuse(found)
        return self._instant(found, 0, moments[0])

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return where one step leads; see `Stepper`."""
        try:
            return self._advanced(now, list(ends))
        except HoldfastError as cause:
            if len(ends) == 1:
                return [Advance(ends[0], None, NO_GAPS, np.zeros(4), failure=cause)]
            return [self.advance(now, [end])[0] for end in ends]  # who fails alone fails alone

    def _advanced(self, now: Instant, ends: list[float]) -> list[Advance]:
        courses = [course_of(now, end, self.scheme) for end in ends]
        found = []
        for end, step in zip(ends, answered_together(courses, partial(self._answers, now.memory)), strict=True):
            error = self.tolerance.ratio(step.estimates, now.state, step.later.state)
            found.append(Advance(end, step.later, step.gaps, step.work, error))
        return found

    def _answers(self, memory: Any, questions: Sequence[Question]) -> list[Any]:
        """Return what steps ask, all of them the same."""
        times, states = [one.t for one in questions], [one.state for one in questions]
        if isinstance(questions[0], Closing):
            closed = self._run(times, states, [self._still(t) for t in times], None, held=False)
            _refuse(closed)
            return [(state_of(closed, row), gaps_of(closed, row)) for row in range(len(questions))]
        found, moments = self._evaluated(times, states, memory)
        _refuse(found)
        return [
            _slope(found["slope"][row], one) if isinstance(one, Stage) else self._instant(found, row, moments[row])
            for row, one in enumerate(questions)
        ]

    def _instant(self, systems: Systems, row: int, at: Moment) -> Instant:
        tau = systems["drive"][row].copy() if at.tau is None else at.tau
        kept = systems["memory"][row].copy() if at.tau is None and "memory" in systems else at.memory
        return instant_of(systems, row, at.t, at.chain, at.inputs, tau, kept, self.generic_rank)

    def _evaluated(self, times: list[float], states: list[State], memory: Any) -> tuple[Systems, list[Moment]]:
        """Return what follows from the states under the controller's torques."""
        moments = [self._told(t, state, memory) for t, state in zip(times, states, strict=True)]
        return self._run(times, states, moments, memory, held=True), moments

    def _told(self, t: float, state: State, memory: Any) -> Moment:
        chain, inputs = self._surroundings_at(t)
        if self.controller is None:
            return Moment(t, chain, inputs, None, memory)
        tau, kept = answer(self.controller(t, state, memory))
        tau = checks.numbers(tau, (chain.joint_count,), "controller: torques", StateError)
        return Moment(t, chain, inputs, tau, kept)

    def _still(self, t: float) -> Moment:
        chain, inputs = self._surroundings_at(t)
        return Moment(t, chain, inputs, np.zeros(chain.joint_count), None)

    def _surroundings_at(self, t: float) -> tuple[ClosedChain, Inputs]:
        """Return chain and inputs at a time; wrenches on links are not ignored but refused."""
        chain, inputs = self.environment.at(t)
        shaped = inputs.shaped(chain)
        if shaped.link_wrenches is not None and shaped.link_wrenches.any():
            raise MethodNotApplicable(
                f"stagewise steps, t = {t:g} s: expected no external wrenches on links, got some; a run whose inputs"
                " give them from t = 0 on, zeros at first, is taken by the reference"
            )
        return chain, shaped

    def _run(self, times: list[float], states: list[State], moments: list[Moment], memory: Any, held: bool) -> Systems:
        """Return the systems after a step of length zero."""
        systems = self.kernel.systems(state_rows(states), memory if "memory" in self.kernel.carried else None)
        inputs = {
            "begin": np.array(times),
            "step": np.array(0.0),
            "held": np.array(float(held)),
            "object_wrench": np.array([m.inputs.object_wrench for m in moments]),
        }
        if self.controller is not None:
            inputs["control.tau"] = np.array([m.tau for m in moments])
        self.kernel.run(systems, inputs, self._bases(moments), 1, 1)
        return systems

    def _bases(self, moments: list[Moment]) -> dict[str, Array]:
        """Return where the bases are and how they move, if they do."""
        if not moving(self.environment):
            return {}
        return {
            "base_R": np.array([[arm.base.R for arm in m.chain.arms.values()] for m in moments]),
            "base_p": np.array([[arm.base.p for arm in m.chain.arms.values()] for m in moments]),
            "base_twist": np.array([m.inputs.base_twists for m in moments]),
            "base_acceleration": np.array([m.inputs.base_accelerations for m in moments]),
        }


def moving(environment: Environment) -> bool:
    """Return whether bases move, or what acts on the chain changes with time."""
    return bool(environment.base_motion) or unsteady(environment.inputs)


def unsteady(given: Inputs | Callable[[float], Inputs]) -> bool:
    """Return whether inputs move bases, or change with time."""
    return callable(given) or given.base_twists is not None or given.base_accelerations is not None


def _slope(found: Array, at: Stage) -> Array:
    """Return the slope at a stage; the machine took the attitude there for a step's start."""
    n = len(at.state.q)
    return np.concatenate(
        [found[: 2 * n], rotation_vector_rate(at.turn, at.state.object_twist[:3]), found[2 * n + 3 :]]
    )


def _refuse(systems: Systems) -> None:
    for code in systems["code"]:
        fault = failure(code)
        if fault is not None:
            raise fault
