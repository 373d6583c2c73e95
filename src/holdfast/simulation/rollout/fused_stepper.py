"""The stepper for whole steps in machine code, with a traceable law and base motions and constant wrenches."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from holdfast.compiled.structure import Options
from holdfast.control.controller import ControlLaw
from holdfast.dynamics.contact.fixed_modes import ContactModes
from holdfast.questions.arrays import FLOATING, STATE, state_of
from holdfast.simulation.adaptive import Tolerance
from holdfast.simulation.environment import Environment
from holdfast.simulation.increment import no_turns
from holdfast.simulation.instant import Instant
from holdfast.simulation.rollout.between_steps import ACCOUNTS, CONSTRAINT, ROWS
from holdfast.simulation.rollout.kernel import StepKernel, Systems
from holdfast.simulation.rollout.rows import (
    StageInputs,
    failure,
    gaps_of,
    instant_of,
    late,
    refuse,
    slope_at,
    state_rows,
)
from holdfast.simulation.rollout.stage_values import acting_on, wrench_arrays
from holdfast.simulation.rollout.successive_steps import Again, Driven, SuccessiveSteps
from holdfast.simulation.runge_kutta import Tableau
from holdfast.simulation.sample import arrays_of
from holdfast.simulation.step import EvaluationRequest, Gaps, ProjectionRequest, StageRequest, rows_held_near
from holdfast.simulation.stepper import NO_GAPS, Advance
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State

MOST_TOGETHER = 256  # steps
MODES = ("touch_mode", "touch_slip")  # what contacts do in a step, among the arrays of an instant


class Taken(NamedTuple):
    """The results of successive steps.

    Attributes:
        ends: results at the points of the steps, (k, points, ...) by name.
        starts: evaluations after the jumps at which steps begin, (k, 1, ...) by name.
        taken: number of steps that were taken; results of the others mean nothing.
        again: returns results at further points, see `SuccessiveSteps.again`; under Python functions with the values
            there that the head of `python_law_stepper` tells.
        memories: as in `Driven`; None if they are part of the results.
        interruption: what interrupted the controller, such as Ctrl-C.
    """

    ends: Systems
    starts: Systems
    taken: int
    again: Again
    memories: tuple[Mapping[int, Any], Mapping[int, Any]] | None = None
    interruption: BaseException | None = None


@dataclass(frozen=True, eq=False)
class FusedStepper:
    """Takes whole steps in machine code, for traceable laws and base motions and constant wrenches; see `Stepper`.

    Attributes:
        environment: the chain, its base motions and external inputs.
        kernel: the compiled step.
        scheme: the Runge-Kutta scheme.
        generic_rank: rank of the constraint away from singular configurations.
        values: values of the law's parameters, with the names of the kernel.
        tolerance: the tolerance by which the estimated errors are divided to give `Advance.error`.
    """

    contacts: ClassVar[str] = ""  # see `Options`

    environment: Environment
    kernel: StepKernel
    scheme: Tableau
    generic_rank: int
    values: Mapping[str, Array] = field(default_factory=dict)
    tolerance: Tolerance = field(default_factory=Tolerance)

    @classmethod
    def of(
        cls,
        environment: Environment,
        law: ControlLaw,
        scheme: Tableau,
        generic_rank: int,
        values: Mapping[str, Array] | None = None,
        tolerance: Tolerance | None = None,
    ) -> Self:
        """Return the stepper for a law with the given values of its parameters."""
        motions = environment.base_motion
        options = replace(options_for(environment), adaptive=scheme.adaptive, contacts=cls.contacts)
        kernel = StepKernel(environment.chain, law, scheme, generic_rank, motions=motions, options=options, quick=True)
        return cls(environment, kernel, scheme, generic_rank, by_name(values or {}), tolerance or Tolerance())

    def start(self, t: float, state: State, memory: Any) -> tuple[Instant, Gaps]:
        """Return the chain at a given state, projected onto the grasps; see `Stepper`."""
        rows = rows_held_near(self.environment, t, state, self.generic_rank)
        systems, (kept,) = self._at([t], [state], memory, rows, project=True)
        return self.instant(systems, 0, t, kept), gaps_of(systems, 0)

    def evaluate(self, t: float, state: State, memory: Any) -> Instant:
        """Return the chain at a given state without projection."""
        systems, (kept,) = self._at([t], [state], memory, None)
        return self.instant(systems, 0, t, kept)

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return the results of single steps; see `Stepper`."""
        return self._advanced(self.start_of(now, len(ends)), now.t, ends, {}, now.memory)

    def _advanced(
        self, systems: Systems, begin: float, ends: Sequence[float], given: Mapping[str, Array], memory: Any
    ) -> list[Advance]:
        """Take steps of several systems in place, and return their results; `given` are inputs of the law."""
        steps = np.array(ends) - begin
        self.kernel.run(systems, {**self._inputs(np.array(begin), steps, False), **given}, {})
        self._choose_forces(systems, begin + steps)
        return [self._advance(systems, row, end, memory) for row, end in enumerate(ends)]

    def start_of(self, now: Instant, count: int = 1) -> Systems:
        """Return a number of systems at the start of steps from an instant; forces and accelerations are not set."""
        systems = self.kernel.systems(state_rows([now.state] * count), now.memory)
        systems["slope"][...], systems["drive"][...] = now.rates(no_turns(now.state)), now.tau
        hold_rows(systems, now.result.held)
        return systems

    def carried_at(self, now: Instant) -> Systems:
        """Return an instant as a system, with its condition and accelerations."""
        return {**self.start_of(now), **arrays_of(now)}

    def take(
        self,
        now: Instant,
        times: Array,
        jumps: Array,
        remember: Callable[[int, Systems], Array | None] | None,
    ) -> Taken:
        """Return the results of successive steps at several points of each.

        Each step leads on from the last point of the one before. All arrays are overwritten by the next call.

        Args:
            now: the instant at which the first step begins, before a jump.
            times: (k, points + 1) times at which the steps begin, and their points [s]; at most `MOST_TOGETHER` steps.
            jumps: (k,) whether torques or inputs jump at the start of each step.
            remember: function of the number of a step and of the results of the steps before it that returns the memory
                of the law from then on, or None for no change; None if the memory does not change between steps.
        """
        count, points = len(times), times.shape[1] - 1
        taker = self._takers.get(points)
        if taker is None:
            taker = self._takers[points] = SuccessiveSteps(self.kernel, MOST_TOGETHER, points)
        asked = None if remember is None else lambda k: remember(k, taker.ends)
        driven = self._driven(now, times)
        done = taker.take(
            self.start_of(now), times[:, 0], times[:, 1:] - times[:, :1], jumps, self._given, asked, driven
        )
        ends, starts = ({name: x[:count] for name, x in arrays.items()} for arrays in (taker.ends, taker.starts))
        for part, at in ((ends, times[:, 1:]), *([(starts, times[:, 0])] if jumps.any() else [])):
            of_systems = {name: x.reshape(at.size, *x.shape[2:]) for name, x in part.items()}
            self._choose_forces(of_systems, at.ravel())
        if driven is None:
            return Taken(ends, starts, done, taker.again)
        return Taken(ends, starts, done, taker.again, driven.memories, driven.interruption)

    def _driven(self, now: Instant, times: Array) -> Driven | None:
        """Return what sets the torques of steps at these times; None if a law computes them."""
        return None

    def follows(self, now: Instant) -> bool:
        """Return whether steps from an instant may be taken together."""
        return True

    def modes_before(self, starts: Mapping[str, Array], k: int, modes: ContactModes | None) -> ContactModes | None:
        """Return in which modes of contacts the end of a step is evaluated.

        Args:
            starts: results at the starts of steps, (steps, ...) by name.
            k: number of the step.
            modes: those in which the first step began.
        """
        return modes

    def of_samples(self, x: Mapping[str, Array]) -> Systems:
        """Return what samples record beside what machine code carries, from their arrays (k, ...) by name."""
        return {}

    def in_halves(self, starts: Mapping[str, Array], times: Array) -> list[Systems]:
        """Return the results of both halves of steps that do not depend on each other.

        Args:
            starts: carried arrays at the start of each step, (k, ...) by name.
            times: (k, 2) their starts and ends [s].
        """
        begin, end = times.T
        middle, at, found = begin + 0.5 * (end - begin), starts, list[Systems]()
        for a, b in ((begin, middle), (middle, end)):
            state = {name: at[name] for name in (*STATE, *FLOATING, *MODES) if name in at}
            systems = self.kernel.systems(state, starts.get("memory"))  # which is updated once per step
            systems["slope"][...] = at["slope"]
            hold_rows(systems, at.get("held_rows"))
            self.kernel.run(systems, self._inputs(a, b - a, False), {})
            found.append(systems)
            at = systems
        return found

    @cached_property
    def _takers(self) -> dict[int, SuccessiveSteps]:
        return {}

    def instant(self, systems: Systems, row: int, t: float, memory: Any) -> Instant:
        """Return one of several systems as an instant, evaluated in full when this is needed.

        Args:
            systems: systems by name, (systems, ...) each; they must not be overwritten later.
            row: number of the system.
            t: its time [s].
            memory: memory passed to the law.
        """
        chain, tau = self.environment.chain, systems["drive"][row]
        return late(systems, row, t, chain, tau, lambda: self._whole(systems, row, t, memory))

    def _advance(self, systems: Systems, row: int, end: float, memory: Any) -> Advance:
        fault = failure(systems["code"][row])
        if fault is not None:
            return Advance(end, None, NO_GAPS, np.zeros(4), failure=fault)
        instant = self.instant(systems, row, end, memory)
        error = float(systems["error"][row]) if self.scheme.adaptive else 0.0
        return Advance(end, instant, gaps_of(systems, row), systems["work"][row].copy(), error)

    def replies(self, now: Instant, requests: Sequence[EvaluationRequest]) -> list[Any]:
        """Return the replies to requests; see `Stepper`."""
        times, states, held = [one.t for one in requests], [one.state for one in requests], now.result.held
        first, memory = requests[0], now.memory
        projecting = isinstance(first, ProjectionRequest)
        rows = held if projecting or isinstance(first, StageRequest) else None
        systems, kept = self._at(times, states, memory, rows, project=projecting, evaluate=not projecting)
        if projecting:
            return [(state_of(systems, row), gaps_of(systems, row)) for row in range(len(times))]
        return [
            slope_at(systems["slope"][row], one)
            if isinstance(one, StageRequest)
            else self.instant(systems, row, one.t, kept[row])
            for row, one in enumerate(requests)
        ]

    def _at(
        self,
        times: list[float],
        states: list[State],
        memory: Any,
        rows: Array | None,
        *,
        project: bool = False,
        evaluate: bool = True,
    ) -> tuple[Systems, list[Any]]:
        """Return the systems at the given states, and the memories from there; an error is raised if one fails.

        Args:
            times: their times [s].
            states: states of the systems.
            memory: memory passed to the law.
            rows: rows of the constraint to satisfy; None to choose them at the given states.
            project: project the states onto the grasps.
            evaluate: evaluate them: those that are projected with rows that are chosen there.
        """
        systems = self.kernel.systems(state_rows(states), memory)
        hold_rows(systems, rows)
        keep = rows is not None and not (project and evaluate)
        inputs = self._inputs(np.array(times), np.array(0.0), not project) | {"keep_rows": np.array(float(keep))}
        given, kept = self._asked(systems, inputs, memory, project, evaluate)
        self.kernel.run(systems, inputs | given, {})
        refuse(systems)
        if evaluate and not keep:  # of stages only the slope is used
            self._choose_forces(systems, np.array(times))
        return systems, kept

    def _choose_forces(self, systems: Systems, t: Array) -> None:
        """Choose the forces of systems at the given times [s], if they are not unique; see `StepKernel`."""
        self.kernel.choose_forces(systems, self._inputs(t, np.array(0.0), True), {})

    def _asked(
        self, systems: Systems, inputs: dict[str, Array], memory: Any, project: bool, evaluate: bool
    ) -> tuple[dict[str, Array], list[Any]]:
        """Return further inputs of the law for `_at`, and the memories from there; machine code has both."""
        return {}, [memory] * len(inputs["begin"])

    def accounts(self, t: Array, arrays: Mapping[str, Array]) -> dict[str, Array]:
        """Return what a run records besides the motion; see `Accounting`."""
        return self.kernel.ask(ACCOUNTS, systems_at(self.kernel, arrays), self._inputs(t, np.array(0.0), True), {})

    def constraint(self, times: Sequence[float], states: Sequence[State]) -> Array:
        """Return the rows of the constraint; see `Stepper`."""
        inputs = self._inputs(np.array(times), np.array(0.0), True)
        return self.kernel.ask(CONSTRAINT, self.kernel.systems(state_rows(states)), inputs, {})[ROWS]

    def _inputs(self, begin: Array, steps: Array, held: bool) -> dict[str, Array]:
        """Return the inputs of the machine code."""
        return {**self._given, "begin": begin, "step": steps, "held": np.array(float(held))}

    @cached_property
    def _given(self) -> dict[str, Array]:
        """The inputs that all steps share."""
        tolerance = np.array([self.tolerance.rtol, self.tolerance.atol])
        return {**shared_inputs(self.kernel, self._acting, self.values), "tolerance": tolerance}

    def _whole(self, systems: Systems, row: int, t: float, memory: Any) -> Instant:
        chain, inputs = self.environment.chain, self._acting
        if self.environment.base_motion or callable(self.environment.inputs):
            chain, moving = self.environment.at(t, state_of(systems, row))
            inputs = moving.shaped(chain)
        return instant_of(systems, row, StageInputs(t, chain, inputs, None, memory))

    @cached_property
    def _acting(self) -> Inputs:
        return constant_inputs(self.environment)


def constant_inputs(environment: Environment) -> Inputs:
    """Return the constant inputs of the chain, without base motions; none if they are a function."""
    acting = environment.inputs
    return (acting if isinstance(acting, Inputs) else Inputs()).shaped(environment.chain)


def shared_inputs(kernel: StepKernel, acting: Inputs, values: Mapping[str, Array]) -> dict[str, Array]:
    """Return the inputs of machine code that all steps of a run share; `simulate` searches for singularities itself."""
    wrenches = wrench_arrays(acting_on(kernel.chain, kernel.structure.options), acting)
    return {**wrenches, "search": np.array(0.0), **values}


def options_for(environment: Environment) -> Options:
    """Return the options of machine code for an environment whose bases move by `base_motion` alone."""
    acting = environment.inputs
    constant = isinstance(acting, Inputs)
    return Options(
        link_wrenches=not constant or any(x is not None for x in (acting.link_wrenches, acting.trunk_link_wrenches))
    )


def by_name(values: Mapping[str, Array]) -> dict[str, Array]:
    """Return the values of a law's parameters with the names of the kernel."""
    return {f"control.{name}": x for name, x in values.items()}


def systems_at(kernel: StepKernel, arrays: Mapping[str, Array]) -> Systems:
    """Return systems with the states and forces of several instants, (k, ...) each by the names of machine code."""
    given = {name: x for name, x in arrays.items() if name in kernel.carried and name != "memory"}
    return kernel.systems(given, count=len(arrays["q"]))


def hold_rows(systems: Systems, held: Array | None) -> None:
    """Set the rows of the constraint that the steps of these systems satisfy; None leaves them unchanged."""
    if held is not None:
        systems["held_rows"][...] = held
