"""Steps of chains that are answered as forests, by the same schemes as those of serial chains."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from holdfast.control.controller import Controller, GivenLaw, torques_and_memory
from holdfast.dynamics.tree.forest_simulate import (
    ForestEngine,
    ForestSample,
    Slope,
    forest_step,
)
from holdfast.dynamics.tree.mechanism_terms import (
    body_wrenches,
    chain_arrays_of,
    chain_state,
    driven_joints,
    flat_state,
    joint_rows,
    require_passive,
)
from holdfast.dynamics.tree.varied_forest import ForestArguments, rates_of_positions, unit_quaternions
from holdfast.errors import ClosureError, ModelError, SingularChainError, StateError
from holdfast.forces.margins import joint_coordinates
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.adaptive import Tolerance, error_ratio
from holdfast.simulation.environment import Environment, require_wrenches
from holdfast.simulation.instant import Instant, late_instant
from holdfast.simulation.interpolant import quadratic, quintic
from holdfast.simulation.joint_friction import friction_torque, joint_friction
from holdfast.simulation.mechanism_margins import MechanismSignals
from holdfast.simulation.mechanism_moment import MechanismMoment
from holdfast.simulation.runge_kutta import Tableau, runge_kutta_step
from holdfast.simulation.step import Gaps
from holdfast.simulation.stepper import NO_GAPS, Advance
from holdfast.spatial.scalar import Array, Scalar
from holdfast.state import Inputs, State, found_state, shaped_inputs


class MechanismInput(NamedTuple):
    """What acts on a chain at one time and state.

    Attributes:
        state: the state.
        given: the arguments of its forest.
        tau: (n,) torques of the drives.
        memory: memory of the controller from there.
        inputs: external wrenches.
    """

    state: State
    given: ForestArguments
    tau: Array
    memory: Any
    inputs: Inputs


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
        closed, drift = self.closed(state)
        now = self.evaluate(t, closed, memory)
        return now, gaps_at(drift, now)

    def closed(self, state: State) -> tuple[State, tuple[Scalar, Scalar]]:
        """Return a state that is brought back to closures and couplings, and the largest gaps before."""
        chain = self.environment.chain
        q, qd, drift = self.engine.closed(*flat_state(chain, state))
        return chain_state(chain, q, qd), drift

    def evaluate(self, t: float, state: State, memory: Any) -> MechanismMoment:
        """Return the chain at a given state; see `Stepper`."""
        return self._moment(t, self._acting(t, state, *flat_state(self.environment.chain, state), memory))

    def between(self, now: Instant, later: Instant | None) -> Callable[[float], Instant]:
        """Return the chain as a function of time between the ends of a step, on the quintics through them.

        It is closed where forces are not unique, since rows that follow from others contradict each other elsewhere.
        """
        assert isinstance(now, MechanismMoment) and isinstance(later, MechanismMoment)
        chain = self.environment.chain
        forest = chain.as_forest.forest

        def at(t: float) -> Instant:
            x, rates = now.knot.until(later.knot, (t - now.t) / (later.t - now.t))
            q, qd = unit_quaternions(forest, x), rates_of_positions(forest, x, rates)
            found = self._acting(t, None, q, qd, now.memory)

            def whole() -> Instant:
                if now.sample.now.unique:
                    return self._moment(t, found)
                closed = self.engine.closed(q, qd)
                return self._moment(t, self._acting(t, None, *closed[:2], now.memory))

            return late_instant(t, (found.state.q, found.state.qd, found.tau), None, whole)

        return at

    def margins_between(
        self, now: Instant, later: Instant, times: Sequence[float], signals: MechanismSignals
    ) -> Array | None:
        """Return the margins at times between the ends of a step, (k, signals), on the quintics through the ends.

        Torques lie on the quadratic through the controller's answers at the stages; a `ControlLaw` is asked anew.

        Returns:
            None if torques half-way through the step are not known, or the engine does not find wrenches there.
        """
        assert isinstance(now, MechanismMoment) and isinstance(later, MechanismMoment)
        chain, h = self.environment.chain, later.t - now.t
        forest, s = chain.as_forest.forest, ((np.array(times) - now.t) / h)[:, None]
        asked = isinstance(self.controller, GivenLaw)
        x, rates = now.knot.until(later.knot, s) if asked or signals.limited_rows else (s, s)
        if asked:
            rows = zip(x, rates, strict=True)
            places = [(unit_quaternions(forest, a), rates_of_positions(forest, a, b)) for a, b in rows]
            states = [found_state(chain_arrays_of(chain, *place)) for place in places]
            tau = np.array([self._asked(*at, now.memory)[0] for at in zip(times, states, strict=True)])
        elif later.halfway is None:
            return None
        else:
            tau = quadratic(now.tau, later.halfway, later.tau, s)
        q, qd = quintic(*_of_joints(chain, now), *_of_joints(chain, later), h, s)
        found = np.zeros((len(times), 0))
        if signals.limited_rows:
            if not isinstance(self.environment.inputs, Inputs):
                return None
            drives = np.array([self.drives(*row) for row in zip(tau, qd, strict=True)])
            margins = self.engine.margins(x, rates, drives, now.sample.given.wrenches)
            if margins is None:
                return None
            found = margins[:, signals.limited_closures]
        return signals.of_coordinates(q, qd, tau, found)

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return the results of single steps; see `Stepper`."""
        return [self._to(now, end) for end in ends]

    def _to(self, now: Instant, end: float) -> Advance:
        assert isinstance(now, MechanismMoment)
        chain, torques = self.environment.chain, []

        def acting(t: float, q: Array, qd: Array) -> ForestArguments:
            found = self._acting(t, None, q, qd, now.memory)
            torques.append(found.tau)
            return found.given

        try:
            step = forest_step(self.engine, acting, now.sample, end, partial(increment, self.scheme))
            later = self.evaluate(end, chain_state(chain, step.q, step.qd), now.memory)
        except (SingularChainError, ClosureError, StateError) as cause:
            return Advance(end, None, NO_GAPS, np.zeros(4), failure=cause)
        except ModelError:  # as of serial chains, see `stepper.attempted`
            failure = StateError("the step overflows float64; try a smaller time step")
            return Advance(end, None, NO_GAPS, np.zeros(4), failure=failure)
        middle = [tau for node, tau in zip(self.scheme.c[1:].tolist(), torques, strict=False) if node == 0.5]
        later = replace(later, halfway=np.mean(middle, axis=0) if middle else None)
        error = error_ratio(step.estimates, self._allowed(now, later))
        return Advance(end, later, gaps_at(step.drift, later), step.work, error)

    def _allowed(self, before: MechanismMoment, after: MechanismMoment) -> Array:
        """Return the error allowed in q and qd, (n_q + n_v,): one size for all positions and one for all rates."""
        assert self.tolerance.atol is not None
        pairs = ((getattr(one.sample.given, name) for one in (before, after)) for name in ("q", "qd"))
        sizes = [(len(a), max(np.abs(a).max(initial=0.0), np.abs(b).max(initial=0.0))) for a, b in pairs]
        return self.tolerance.atol + self.tolerance.rtol * np.concatenate([np.full(n, size) for n, size in sizes])

    def _moment(self, t: float, at: MechanismInput) -> MechanismMoment:
        now = self.engine.instant(at.given)
        sample, found = ForestSample(t, at.given, now), (now, now.power)
        chain, acting = self.environment.chain, (at.inputs, at.tau, at.memory)
        return MechanismMoment(t, at.state, chain, *acting, *found, sample=sample, engine=self.engine)  # pyright: ignore

    def _acting(self, t: float, state: State | None, q: Array, qd: Array, memory: Any) -> MechanismInput:
        """Return what acts at a time, and at positions and rates of the forest, whose state is found if it is None."""
        chain = self.environment.chain
        state = found_state(chain_arrays_of(chain, q, qd)) if state is None else state
        tau, memory = self._asked(t, state, memory)
        inputs, wrenches = self.constant or self._wrenches(self.environment.at(t, state)[1])
        given = ForestArguments(chain.as_forest.forest, q, qd, self.drives(tau, state.qd), wrenches)
        return MechanismInput(state, given, tau, memory, inputs)

    def drives(self, tau: Array, rates: Array) -> Array:
        """Return the torques on the bodies of the forest, (n_v,), from those of the drives and the joints' rates."""
        chain = self.environment.chain
        found = np.zeros(chain.as_forest.forest.velocity_count)
        found[joint_rows(chain)] = tau - friction_torque(self._friction, rates) if self._friction.any() else tau
        return found

    def _asked(self, t: float, state: State, memory: Any) -> tuple[Array, Any]:
        """Return the torques of the controller, and its memory."""
        chain = self.environment.chain
        tau, memory = torques_and_memory(self.controller(t, state, memory))
        tau = checks.numbers(tau, (chain.joint_count,), "controller: torques", StateError)
        if tau[self._passive].any():
            require_passive(chain, tau)
        return tau, memory

    @cached_property
    def _friction(self) -> Array:
        return joint_friction(self.environment.chain)

    @cached_property
    def _passive(self) -> Array:
        return ~driven_joints(self.environment.chain)

    @cached_property
    def constant(self) -> tuple[Inputs, Array] | None:
        """The inputs and the wrenches on the forest's bodies, if they are constant."""
        given = self.environment.inputs
        return self._wrenches(given) if isinstance(given, Inputs) else None

    def _wrenches(self, inputs: Inputs) -> tuple[Inputs, Array]:
        require_wrenches(inputs, "of a chain that is answered as a forest")
        chain = self.environment.chain
        return inputs, body_wrenches(chain, shaped_inputs(chain, inputs))


def _of_joints(chain: ClosedChain, at: MechanismMoment) -> tuple[Array, Array, Array]:
    """Return coordinates, rates and accelerations of the joints, (n,) each."""
    return joint_coordinates(chain, at.state.q), at.state.qd, at.accelerations[joint_rows(chain)]


def increment(scheme: Tableau, first: Array, h: Scalar, slope: Slope) -> tuple[Array, list[Array]]:
    """Return the increment of a step and the estimates of its error; see `forest_simulate.Scheme`."""
    step, found = runge_kutta_step(first, h, scheme, lambda i, y: (float(scheme.c[i]) * h, y)), None
    while True:
        try:
            later, y = step.send(found)  # pyright: ignore[reportArgumentType]
        except StopIteration as end:
            return end.value
        found = slope(later, y)


def gaps_at(drift: tuple[Scalar, Scalar], now: MechanismMoment) -> Gaps:
    """Return the gaps before a chain was closed, and of the instant after it."""
    found = now.account
    return Gaps(np.array([drift[0], found.position_gap]), np.array([drift[1], found.velocity_gap]))
