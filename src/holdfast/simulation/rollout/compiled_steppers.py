"""The steppers of `simulate` that use machine code, and the choice of the stepper for a run.

If the controller and the base motions can be compiled, a whole step is one call of machine code (`FusedStepper`), and
steps to several end times cost about as much as one. If the controller cannot, or wrenches are a function, it is one
call for each of their answers (`PythonLawStepper`). Otherwise, dynamics, projection and a traced law are machine code,
while the environment or the controller is evaluated in Python at every stage (`StagewiseStepper`, for any scheme).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, cast

import numpy as np

from holdfast.compiled.structure import Options
from holdfast.control.controller import ControlLaw, Controller, GivenLaw, held_torques, torques_and_memory
from holdfast.control.traced_law import law_of
from holdfast.errors import HoldfastError, MethodNotApplicable, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.trunk import TRUNK, bodies_of
from holdfast.questions.arrays import state_of
from holdfast.simulation.adaptive import Tolerance
from holdfast.simulation.environment import MOVING_BASES, Environment, GivenInputs
from holdfast.simulation.instant import Instant
from holdfast.simulation.linearly_implicit import Implicit
from holdfast.simulation.margins import Signals
from holdfast.simulation.rollout.between_steps import ACCOUNTS, CONSTRAINT, ROWS
from holdfast.simulation.rollout.fused_stepper import FusedStepper, by_name, hold_rows, systems_at
from holdfast.simulation.rollout.kernel import StepKernel, Systems
from holdfast.simulation.rollout.python_law_stepper import PythonLawStepper
from holdfast.simulation.rollout.rows import StageInputs, gaps_of, instant_of, late, refuse, slope_at, state_rows
from holdfast.simulation.runge_kutta import EULER, Tableau
from holdfast.simulation.step import (
    EvaluationRequest,
    Gaps,
    ProjectionRequest,
    StageRequest,
    rows_held_near,
    run_steps_together,
    step_generator,
)
from holdfast.simulation.stepper import NO_GAPS, Advance, ReferenceStepper, Stepper
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State

STEPS_WORTH_COMPILING = 45  # steps: compiling takes as long as about this many steps without machine code
ADAPTIVE_WORTH_COMPILING = (
    200  # steps of the twelve stages of an adaptive scheme, taken stage by stage, as long as that
)
COST_OF_VERIFICATION = 16  # with limits, the evaluations inside a step cost about as much as this many steps


@dataclass(frozen=True, eq=False)
class StagewiseStepper:
    """Takes steps whose environment and controller are evaluated in Python at every stage; see `Stepper`.

    Attributes:
        environment: the chain, its base motions and external inputs; wrenches on links are possible only if the inputs
            depend on the state.
        controller: the controller.
        generic_rank: rank of the constraint away from singular configurations.
        scheme: the Runge-Kutta scheme.
        tolerance: the tolerance by which the estimated errors are divided to give `Advance.error`.
        law: a law with the torques of the controller, which is then compiled instead; None if there is none.
    """

    environment: Environment
    controller: Controller
    generic_rank: int
    scheme: Tableau
    tolerance: Tolerance
    law: ControlLaw | None = None

    @cached_property
    def kernel(self) -> StepKernel:
        """A compiled step of length zero, which projects or evaluates states."""
        chain, moving, implicit = self.environment.chain, bases_move(self.environment), self.scheme.implicit
        options = Options(base_motion=moving, implicit=implicit, link_wrenches=self.environment.of_state)
        law = held_torques(chain.joint_count) if self.law is None else self.law
        return StepKernel(chain, law, EULER, self.generic_rank, options=options, quick=True)

    @cached_property
    def values(self) -> Mapping[str, Array]:
        """Values of the law's parameters, with the names of the kernel."""
        return by_name(self.controller.values if isinstance(self.controller, GivenLaw) else {})

    def start(self, t: float, state: State, memory: Any) -> tuple[Instant, Gaps]:
        """Return the chain at a given state, projected onto the grasps; see `Stepper`."""
        held = rows_held_near(self.environment, t, state, self.generic_rank)
        ((closed, gaps),) = self._closed([t], [state], held)
        return self.evaluate(t, closed, memory), gaps

    def evaluate(self, t: float, state: State, memory: Any) -> Instant:
        """Return the chain at a given state without projection."""
        found, (stage,) = self._evaluated([t], [state], memory, None)
        return instant_of(found, 0, stage)

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return where one step leads; see `Stepper`."""
        generators = [step_generator(now, end, self.scheme) for end in ends]
        try:
            steps = run_steps_together(generators, partial(self.replies, now))
        except HoldfastError as cause:
            if len(ends) == 1:
                return [Advance(ends[0], None, NO_GAPS, np.zeros(4), failure=cause)]
            return [self.advance(now, [end])[0] for end in ends]  # a failure of one end must not affect the others
        errors = [self.tolerance.ratio(step.estimates, now.state, step.later.state) for step in steps]
        return [
            Advance(end, step.later, step.gaps, step.work, error)
            for end, step, error in zip(ends, steps, errors, strict=True)
        ]

    def replies(self, now: Instant, requests: Sequence[EvaluationRequest]) -> list[Any]:
        """Return the replies to requests; see `Stepper`."""
        times, states, held = [one.t for one in requests], [one.state for one in requests], now.result.held
        if isinstance(requests[0], ProjectionRequest):
            return self._closed(times, states, held)
        implicit = [one.implicit for one in requests if isinstance(one, StageRequest) and one.implicit is not None]
        rows = held if isinstance(requests[0], StageRequest) else None
        found, stages = self._evaluated(times, states, now.memory, rows, implicit)
        return [
            slope_at(found["slope"][row], one) if isinstance(one, StageRequest) else _late(found, row, stages[row])
            for row, one in enumerate(requests)
        ]

    def accounts(self, t: Array, arrays: Mapping[str, Array]) -> dict[str, Array]:
        """Return what a run records besides the motion; see `Accounting`."""
        systems = systems_at(self.kernel, arrays)
        inputs, parameters = self._given(self._stages_of(t.tolist(), systems), held=True)
        return self.kernel.ask(ACCOUNTS, systems, inputs, parameters)

    def constraint(self, times: Sequence[float], states: Sequence[State]) -> Array:
        """Return the rows of the constraint; see `Stepper`."""
        stages = [self._stage_inputs(t, state) for t, state in zip(times, states, strict=True)]
        return self.kernel.ask(CONSTRAINT, self.kernel.systems(state_rows(states)), *self._given(stages, held=True))[
            ROWS
        ]

    def _stages_of(self, times: list[float], systems: Systems) -> list[StageInputs]:
        """Return the inputs at recorded instants, without torques."""
        return [self._stage_inputs(time, state_of(systems, row)) for row, time in enumerate(times)]

    def _closed(self, times: list[float], states: list[State], rows: Array | None) -> list[tuple[State, Gaps]]:
        """Return the states projected onto the grasps, and the gaps before and after."""
        stages = [self._stage_inputs(t, state) for t, state in zip(times, states, strict=True)]
        systems = self._run(states, stages, None, rows, held=False)
        return [(state_of(systems, row), gaps_of(systems, row)) for row in range(len(states))]

    def _evaluated(
        self,
        times: list[float],
        states: list[State],
        memory: Any,
        rows: Array | None,
        implicit: Sequence[Implicit] = (),
    ) -> tuple[Systems, list[StageInputs]]:
        """Return the evaluated systems at the given states, with the controller's torques, and their inputs."""
        stages = [
            self._driven(self._stage_inputs(t, state), state, memory) for t, state in zip(times, states, strict=True)
        ]
        systems = self._run(states, stages, memory, rows, held=True, implicit=implicit)
        if rows is None:  # of stages only the slope is used
            self.kernel.choose_forces(systems, *self._given(stages, held=True))
        return systems, stages

    def _stage_inputs(self, t: float, state: State) -> StageInputs:
        """Return the inputs of the machine code at a time and state, without torques.

        Raises:
            MethodNotApplicable: there are wrenches on links, for which the machine code was not compiled.
        """
        tau = None if self.law is not None else np.zeros(self.environment.chain.joint_count)
        if self._still is not None:
            return StageInputs(t, self.environment.chain, self._still, tau, None)
        chain, inputs = self.environment.at(t, state)
        shaped = inputs.shaped(chain)
        self._require_places(t, shaped)
        return StageInputs(t, chain, shaped, tau, None)

    @cached_property
    def _still(self) -> Inputs | None:
        """The inputs if they are constant; otherwise None."""
        given = self.environment.inputs
        if self.environment.base_motion or not isinstance(given, Inputs):
            return None
        shaped = given.shaped(self.environment.chain)
        self._require_places(0.0, shaped)
        return shaped

    def _require_places(self, t: float, shaped: Inputs) -> None:
        """Refuse inputs for which the machine code was not compiled.

        Raises:
            MethodNotApplicable: there are such inputs; the message names them.
        """
        on_links = () if self.environment.of_state else ("link_wrenches", "trunk_link_wrenches")
        for what in (*on_links, "trunk_base_twist", "trunk_base_acceleration"):
            x = getattr(shaped, what)
            if x is not None and x.any():
                raise MethodNotApplicable(
                    f"stagewise steps, t = {t:g} s: inputs: {what}: expected none, got some; a run whose inputs give"
                    " them from t = 0 on, zeros at first, is taken by the reference"
                )

    def _driven(self, at: StageInputs, state: State, memory: Any) -> StageInputs:
        """Return the inputs of the machine code, completed by the controller's torques and memory."""
        if self.law is not None:
            return replace(at, memory=memory)
        tau, kept = torques_and_memory(self.controller(at.t, state, memory))
        tau = checks.numbers(tau, (at.chain.joint_count,), "controller: torques", StateError)
        return replace(at, tau=tau, memory=kept)

    def _run(
        self,
        states: list[State],
        stages: list[StageInputs],
        memory: Any,
        rows: Array | None,
        held: bool,
        implicit: Sequence[Implicit] = (),
    ) -> Systems:
        """Return the systems after a step of length zero; an error is raised if one fails.

        Args:
            states: states of the systems.
            stages: inputs of the systems.
            memory: memory of the law.
            rows: rows of the constraint to satisfy; None to choose them at the given states.
            held: evaluate the states without projection.
            implicit: additional armatures and torques of each system; empty for none.
        """
        systems = self.kernel.systems(state_rows(states), memory)
        hold_rows(systems, rows)
        inputs, parameters = self._given(stages, held)
        inputs["keep_rows"] = np.array(float(rows is not None))
        if self.scheme.implicit:
            none = np.zeros(self.environment.chain.joint_count)
            inputs["added_armature"] = np.array([one.armature for one in implicit]) if implicit else none
            inputs["added_torque"] = np.array([one.torque for one in implicit]) if implicit else none
        if self.law is None:
            inputs["control.tau"] = np.array([m.tau for m in stages])
        self.kernel.run(systems, inputs, parameters)
        refuse(systems)
        return systems

    def _given(self, stages: list[StageInputs], held: bool) -> tuple[dict[str, Array], dict[str, Array]]:
        """Return the inputs and the parameters of the machine code at several times."""
        inputs = {
            "begin": np.array([m.t for m in stages]),
            "step": np.array(0.0),
            "held": np.array(float(held)),
            "object_wrench": np.array([m.inputs.object_wrench for m in stages]),
            **self.values,
        }
        if self.environment.of_state:
            inputs |= _on_links(self.environment.chain, [m.inputs for m in stages])
        parameters = {}
        if bases_move(self.environment):
            parameters = {
                "base_R": np.array([[arm.base.R for arm in m.chain.arms.values()] for m in stages]),
                "base_p": np.array([[arm.base.p for arm in m.chain.arms.values()] for m in stages]),
                "base_twist": np.array([m.inputs.base_twists for m in stages]),
                "base_acceleration": np.array([m.inputs.base_accelerations for m in stages]),
            }
        return inputs, parameters


def _on_links(chain: ClosedChain, acting: Sequence[Inputs]) -> dict[str, Array]:
    """Return the wrenches on links at several instants, with the names of the machine code; zero if not given."""
    bodies = len(bodies_of(chain.trunk))
    counts = {"link_wrench": sum(arm.joint_count for arm in chain.arms.values()), "trunk_link_wrench": bodies}
    found = {name: np.zeros((len(acting), count, 6)) for name, count in counts.items()}
    for row, one in enumerate(acting):
        for name, given in (("link_wrench", one.link_wrenches), ("trunk_link_wrench", one.trunk_link_wrenches)):
            if given is not None:
                found[name][row] = given
    return found if bodies else {"link_wrench": found["link_wrench"]}


def _late(found: Systems, row: int, at: StageInputs) -> Instant:
    """Return one system as an instant that is evaluated in full only when this is needed."""
    tau = found["drive"][row] if at.tau is None else at.tau
    return late(found, row, at.t, at.chain, tau, lambda: instant_of(found, row, at))


def bases_move(environment: Environment) -> bool:
    """Return whether bases move, or may move because the inputs are a function of time."""
    return bool(environment.base_motion) or (unsteady(environment.inputs) and not environment.of_state)


def unsteady(given: GivenInputs) -> bool:
    """Return whether the inputs contain base motions, or depend on time or state."""
    return not isinstance(given, Inputs) or move_bases(given)


def move_bases(given: Inputs) -> bool:
    """Return whether inputs contain motions of bases."""
    return any(getattr(given, name) is not None for name in MOVING_BASES)


def stepper_for(
    environment: Environment,
    controller: Controller | ControlLaw,
    generic_rank: int,
    scheme: Tableau,
    tolerance: Tolerance,
    steps: int,
) -> Stepper:
    """Return the most suitable stepper for a run; the results of all steppers agree up to rounding.

    A `ControlLaw`, and a controller or base motion whose attribute `traceable` is True, become part of the machine
    code. All other functions are called in Python, once a stage. Runs with few steps of an adaptive scheme, and those
    under Python functions, are taken stage by stage.

    Args:
        environment: the chain, its base motions and external inputs.
        controller: the controller.
        generic_rank: rank of the constraint away from singular configurations.
        scheme: the Runge-Kutta scheme.
        tolerance: tolerance of adaptive schemes.
        steps: the least number of steps that the run will take.

    Raises:
        StateError: the law has parameters, which cannot be given in a run.
        CompileError: the law cannot be traced.
    """
    acting = acting_at_first(environment)
    on_links = any(x is not None for x in (acting.link_wrenches, acting.trunk_link_wrenches))
    chain = environment.chain
    if chain.touching is not None or not (scheme.adaptive or worth_compiling(chain, steps)):
        return ReferenceStepper(environment, controller, generic_rank, scheme, tolerance)
    law, values = law_of(controller, chain), getattr(controller, "values", {})
    motions, constant = environment.base_motion.values(), isinstance(environment.inputs, Inputs)
    traceable = not move_bases(acting) and all(getattr(motion, "traceable", False) for motion in motions)
    if traceable and (not scheme.adaptive or steps >= ADAPTIVE_WORTH_COMPILING):
        if law is not None and constant:
            return FusedStepper.of(environment, law, scheme, generic_rank, values, tolerance)
        if not scheme.implicit and not scheme.adaptive:
            return PythonLawStepper.of_controller(environment, controller, scheme, generic_rank, law)
    if on_links or _moves_trunk_base(environment, acting):  # stagewise steps do not support this
        return ReferenceStepper(environment, controller, generic_rank, scheme, tolerance)
    return StagewiseStepper(environment, controller, generic_rank, scheme, tolerance, law)


def worth_compiling(chain: ClosedChain, steps: int) -> bool:
    """Return whether a run takes so many steps that it is worthwhile to compile one."""
    return steps * (COST_OF_VERIFICATION if len(Signals(chain).limited) else 1) >= STEPS_WORTH_COMPILING


def acting_at_first(environment: Environment) -> Inputs:
    """Return the inputs at t = 0; empty if they depend on the state, because then any wrench is supported."""
    given = environment.inputs
    if isinstance(given, Inputs):
        return given
    return Inputs() if environment.of_state else cast(Callable[[float], Inputs], given)(0.0)


def _moves_trunk_base(environment: Environment, acting: Inputs) -> bool:
    """Return whether the base of a trunk has a prescribed motion."""
    given = (acting.trunk_base_twist, acting.trunk_base_acceleration)
    return TRUNK in environment.base_motion or any(x is not None for x in given)
