"""Steps of chains that are answered as forests, by the same schemes as those of serial chains."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from holdfast.compiled.forest_engine import CompiledForestEngine
from holdfast.control.controller import Controller, torques_and_memory
from holdfast.dynamics.tree.forest_inverse import InverseAt
from holdfast.dynamics.tree.forest_simulate import (
    ForestAccount,
    ForestEngine,
    ForestReference,
    ForestSample,
    Slope,
    closed_near,
    forest_step,
)
from holdfast.dynamics.tree.mechanism_terms import chain_state, flat_state, joint_rows, mechanism_arguments
from holdfast.dynamics.tree.varied_forest import ForestArguments
from holdfast.errors import ClosureError, ModelError, SingularChainError, StateError
from holdfast.model import checks
from holdfast.simulation.adaptive import Tolerance, error_ratio
from holdfast.simulation.environment import Environment, require_wrenches
from holdfast.simulation.instant import Instant, late_instant
from holdfast.simulation.joint_friction import friction_torque, joint_friction
from holdfast.simulation.mechanism_interpolant import ForestKnot, forest_interpolant
from holdfast.simulation.rollout.compiled_steppers import STEPS_WORTH_COMPILING
from holdfast.simulation.runge_kutta import Tableau, runge_kutta_step
from holdfast.simulation.step import Gaps
from holdfast.simulation.stepper import NO_GAPS, Advance
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State


@dataclass(frozen=True, eq=False)
class MechanismMoment(Instant):
    """A chain that is answered as a forest at one time; `result` and `power` are those of `sample.now`.

    Attributes:
        sample: its forest.
        engine: what has evaluated it.
    """

    sample: ForestSample = None  # pyright: ignore[reportAssignmentType]
    engine: ForestEngine = None  # pyright: ignore[reportAssignmentType]

    @cached_property
    def account(self) -> ForestAccount:
        """Its forces, which are the smallest if they are not unique, gaps and energies."""
        return self.engine.account(self.sample.given, self.sample.now)

    @property
    def velocities(self) -> Array:
        """(n_v,) rates of the forest."""
        return self.sample.given.qd

    @property
    def accelerations(self) -> Array:
        """(n_v,) accelerations of the forest."""
        return self.sample.now.qdd


@dataclass(frozen=True, eq=False)
class MechanismStepper:
    """Takes steps of a chain that is answered as a forest; see `Stepper`.

    Attributes:
        environment: the chain and the external wrenches on it.
        controller: the controller that returns the torques.
        engine: evaluates the forest.
        scheme: the Runge-Kutta scheme.
        tolerance: the tolerance by which the estimated errors are divided.
    """

    environment: Environment
    controller: Controller
    engine: ForestEngine
    scheme: Tableau
    tolerance: Tolerance

    def start(self, t: float, state: State, memory: Any) -> tuple[Instant, Gaps]:
        """Return the chain at a given state, closed, and the gaps before and after; see `Stepper`."""
        chain = self.environment.chain
        q, qd, drift = closed_near(self.engine, chain.as_forest.forest, *flat_state(chain, state))
        now = self.evaluate(t, chain_state(chain, q, qd), memory)
        return now, _gaps(drift, now)

    def evaluate(self, t: float, state: State, memory: Any) -> MechanismMoment:
        """Return the chain at a given state; see `Stepper`."""
        return self._moment(t, state, *self._arguments(t, state, memory))

    def between(self, now: Instant, later: Instant | None) -> Callable[[float], Instant]:
        """Return the chain as a function of time between the ends of a step, on the quintics through them.

        It is closed where forces are not unique, since rows that follow from others contradict each other elsewhere.
        """
        assert isinstance(now, MechanismMoment) and isinstance(later, MechanismMoment)
        chain = self.environment.chain
        forest = chain.as_forest.forest
        knots = (ForestKnot(one.t, one.sample.given.q, one.velocities, one.accelerations) for one in (now, later))
        way = forest_interpolant(forest, *knots)

        def at(t: float) -> Instant:
            q, qd = way(t)
            state = chain_state(chain, q, qd)
            found = self._arguments(t, state, now.memory)

            def whole() -> Instant:
                if now.sample.now.unique:
                    return self._moment(t, state, *found)
                closed = closed_near(self.engine, forest, q, qd)
                return self.evaluate(t, chain_state(chain, *closed[:2]), now.memory)

            return late_instant(t, (state.q, state.qd, found[1]), None, whole)

        return at

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return the results of single steps; see `Stepper`."""
        return [self._to(now, end) for end in ends]

    def _to(self, now: Instant, end: float) -> Advance:
        assert isinstance(now, MechanismMoment)
        chain = self.environment.chain

        def acting(t: float, q: Array, qd: Array) -> ForestArguments:
            return self._arguments(t, chain_state(chain, q, qd), now.memory)[0]

        try:
            step = forest_step(self.engine, acting, now.sample, end, partial(_increment, self.scheme))
            later = self.evaluate(end, chain_state(chain, step.q, step.qd), now.memory)
        except (SingularChainError, ClosureError, StateError) as cause:
            return Advance(end, None, NO_GAPS, np.zeros(4), failure=cause)
        except ModelError:  # as of serial chains, see `stepper.attempted`
            failure = StateError("the step overflows float64; try a smaller time step")
            return Advance(end, None, NO_GAPS, np.zeros(4), failure=failure)
        error = error_ratio(step.estimates, self._allowed(now, later))
        return Advance(end, later, _gaps(step.drift, later), step.work, error)

    def _allowed(self, before: MechanismMoment, after: MechanismMoment) -> Array:
        """Return the error allowed in q and qd, (n_q + n_v,): one size for all positions and one for all rates."""
        assert self.tolerance.atol is not None
        pairs = ((getattr(one.sample.given, name) for one in (before, after)) for name in ("q", "qd"))
        sizes = [(len(a), max(np.abs(a).max(initial=0.0), np.abs(b).max(initial=0.0))) for a, b in pairs]
        return self.tolerance.atol + self.tolerance.rtol * np.concatenate([np.full(n, size) for n, size in sizes])

    def _moment(
        self, t: float, state: State, given: ForestArguments, tau: Array, memory: Any, inputs: Inputs
    ) -> MechanismMoment:
        now = self.engine.instant(given)
        sample, found = ForestSample(t, given, now), (now, now.power)
        chain = self.environment.chain
        return MechanismMoment(t, state, chain, inputs, tau, memory, *found, sample=sample, engine=self.engine)  # pyright: ignore

    @cached_property
    def _friction(self) -> Array:
        return joint_friction(self.environment.chain)

    def _arguments(self, t: float, state: State, memory: Any) -> tuple[ForestArguments, Array, Any, Inputs]:
        """Return the arguments of the forest at a time and state, the torques of the drives, the memory and inputs."""
        chain = self.environment.chain
        tau, memory = torques_and_memory(self.controller(t, state, memory))
        tau = checks.numbers(tau, (chain.joint_count,), "controller: torques", StateError)
        inputs = self.environment.at(t, state)[1]
        require_wrenches(inputs, "of a chain that is answered as a forest")
        given = mechanism_arguments(chain, state, tau, inputs)
        net = given.tau.copy()
        if self._friction.any():
            net[joint_rows(chain)] -= friction_torque(self._friction, state.qd)
        return given._replace(tau=net), tau, memory, inputs


class MechanismSteppers:
    """Makes the steppers of a run of a chain that is answered as a forest; see `MakeStepper`.

    Its laws find inverse dynamics by machine code in the engine of the last stepper that was made.
    """

    def __init__(self, steps: int) -> None:
        """Take the least number of steps of the run, by which machine code is chosen."""
        self._steps, self._engine = steps, None

    def __call__(
        self, environment: Environment, controller: Controller, rank: int, scheme: Tableau, tolerance: Tolerance
    ) -> Any:
        """Return a stepper; a negative rank is not known yet."""
        forest = environment.chain.as_forest.forest
        if self._steps < STEPS_WORTH_COMPILING and not scheme.adaptive:
            return MechanismStepper(environment, controller, ForestReference(forest), scheme, tolerance)
        self._engine = CompiledForestEngine(forest, None if rank < 0 else rank)
        return MechanismStepper(environment, controller, self._engine, scheme, tolerance)

    def inverse(self, given: ForestArguments) -> InverseAt | None:
        """Return inverse dynamics by machine code, if there is some for the forest; see `inverse_code`."""
        return None if self._engine is None else self._engine.inverse(given)


def _increment(scheme: Tableau, first: Array, h: float, slope: Slope) -> tuple[Array, list[Array]]:
    """Return the increment of a step and the estimates of its error; see `forest_simulate.Scheme`."""
    step, found = runge_kutta_step(first, h, scheme, lambda i, y: (float(scheme.c[i]) * h, y)), None
    while True:
        try:
            later, y = step.send(found)  # pyright: ignore[reportArgumentType]
        except StopIteration as end:
            return end.value
        found = slope(later, y)


def _gaps(drift: tuple[float, float], now: MechanismMoment) -> Gaps:
    found = now.account
    return Gaps(np.array([drift[0], found.position_gap]), np.array([drift[1], found.velocity_gap]))
