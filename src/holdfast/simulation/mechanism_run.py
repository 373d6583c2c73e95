"""Simulation of chains that are answered as forests, in fixed steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from holdfast.compiled.forest_engine import CompiledForestEngine
from holdfast.control.controller import torques_and_memory
from holdfast.dynamics.impulse import forest_attach
from holdfast.dynamics.tree.forest_inverse import InverseCode, inverse_code
from holdfast.dynamics.tree.forest_simulate import (
    ForestAccount,
    ForestEngine,
    ForestReference,
    ForestSample,
    closed_near,
    forest_start,
    forest_step,
)
from holdfast.dynamics.tree.mechanism_terms import chain_state, flat_state, joint_rows, mechanism_arguments
from holdfast.dynamics.tree.varied_forest import ForestArguments
from holdfast.errors import HoldfastError, MethodNotApplicable, StateError
from holdfast.forces.margins import conditions
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp_rows import GraspRow, grasp_rows, row_name
from holdfast.simulation.bracket import crossing
from holdfast.simulation.environment import Environment, require_wrenches
from holdfast.simulation.events import Attach, Event, Occurrence, happen
from holdfast.simulation.joint_friction import friction_torque, joint_friction
from holdfast.simulation.margins import Policy, ViolationTracker
from holdfast.simulation.mechanism_margins import MechanismInstant, MechanismSignals
from holdfast.simulation.mechanism_sample import MechanismRecord, arrays_of, mechanism_instant
from holdfast.simulation.rollout.compiled_steppers import STEPS_WORTH_COMPILING
from holdfast.simulation.run_record import Listeners
from holdfast.simulation.segment import RunSettings
from holdfast.simulation.stops import just_after
from holdfast.simulation.trajectory import Trajectory
from holdfast.simulation.verification import CROSSING
from holdfast.spatial.frozen import changed
from holdfast.spatial.scalar import Array
from holdfast.state import State, require_state


@dataclass(frozen=True, eq=False)
class Accepted:
    """A run at one instant.

    Attributes:
        sample: the forest.
        found: its forces, gaps and energies.
        at: what margins depend on.
        margins: (signals,) margins.
    """

    sample: ForestSample
    found: ForestAccount
    at: MechanismInstant
    margins: Array


def mechanism_run(settings: RunSettings, state: State, rows: Sequence[GraspRow], listeners: Listeners) -> Trajectory:
    """Return the motion of a chain by Runge-Kutta steps, after each of which it is closed; see `simulate`.

    Margins are evaluated at the end of every step. Where one changes its sign, the step is taken again with other
    lengths until the instant is known to 1e-13 s, O(steps + 10 violations).

    Args:
        settings: what the run is asked, with the chain at the start.
        state: initial state.
        rows: rows of the run's wrenches and margins.
        listeners: functions to call on the way.
    """
    require_state(settings.environment.chain, state)
    run = _Run(settings, rows, listeners)
    run.begin(0.0, state)
    try:
        stopped = run.go()
    except HoldfastError as cause:
        stopped = f"stopped after t = {run.now.sample.t:.6g} s: {cause}"
    return changed(run.record.run(), stopped=stopped, occurrences=tuple(run.happened))


def attached_later(events: Sequence[Event]) -> list[str]:
    """Return the names of the rows of the grasps that events close."""
    return list(dict.fromkeys(row_name(event.arm) for event in events if isinstance(event, Attach)))


class _Run:
    """A run on its way.

    Attributes:
        now: the last accepted instant.
        record: the samples so far.
        happened: the log.
    """

    now: Accepted

    def __init__(self, settings: RunSettings, rows: Sequence[GraspRow], listeners: Listeners) -> None:
        self._settings, self._rows, self._steps, self._events, self._impact = settings, rows, 0, 0, 0.0
        self.happened: list[Occurrence] = []
        self._use(settings.environment.chain, settings.controller, None)
        self._tracker, self._progress = ViolationTracker.blank(len(self._signals)), listeners.progress
        self.record = MechanismRecord(settings.recording, self._signals, listeners)

    def _use(self, chain: ClosedChain, law: Any, memory: Any) -> None:
        """Go on with a chain that has other grasps."""
        settings, forest = self._settings, chain.as_forest.forest
        by_code = len(settings.stops.times) - self._steps >= STEPS_WORTH_COMPILING
        self._engine: ForestEngine = CompiledForestEngine(forest) if by_code else ForestReference(forest)
        inverse = self._engine.inverse if isinstance(self._engine, CompiledForestEngine) else None
        self._acting = _Acting(replace(settings.environment, chain=chain), law, memory, inverse)
        self._signals = MechanismSignals(chain, self._rows)
        self._ending = settings.policy.acting(self._signals)

    def begin(self, t: float, state: State, work: Array | None = None, news: Sequence[Occurrence] = ()) -> None:
        """Begin a smooth stretch at a state."""
        q, qd = flat_state(self._signals.chain, state)
        if any(one.kind == "attach" for one in news):  # whose tip may be off by the tolerance
            q, qd, _ = closed_near(self._engine, self._signals.chain.as_forest.forest, q, qd)
        self._accept(self._found(forest_start(self._engine, self._acting, t, q, qd, work)), {}, news, begins=True)

    def go(self) -> str | None:
        """Take all steps and jumps; return the reason why the run ends early, or None."""
        times, jumps = self._settings.stops
        jump_next = [*jumps[1:].tolist(), False]
        for t, jumps_here, ends in zip(times.tolist(), jumps.tolist(), jump_next, strict=True):
            if jumps_here:
                self._jump(t)
            while (why := self._opened_or_ended()) is None and self.now.sample.t < t:
                self._step(t, ends)
            if why is not None:
                return why
        return None

    def _opened_or_ended(self) -> str | None:
        """Open the grasps that cannot hold, if they are to be opened; return the reason if the run ends here."""
        signals = self._signals
        margins = self.now.margins[self._ending]
        if margins.min(initial=0.0) >= 0.0:
            return None
        i = int(self._ending[np.argmin(margins)])
        name, t = signals.names[i], self.now.sample.t
        if signals.quantities[i] != "grasp" or self._settings.policy.on_slip != "release":
            last = next(one for one in reversed(self.happened) if one.name == name and one.kind == "violation")
            return f"{last.text} at t = {last.t:.12g} s"
        news = Occurrence(t, "release", name, f"'{name}' is released: it cannot hold")
        self._restart(just_after(t), signals.chain.without_grasp(self._rows[i].key), self.now.at.state, [news])
        return self._opened_or_ended()

    def _jump(self, t: float) -> None:
        """Let the events of a time happen."""
        t = t if t > self.now.sample.t else just_after(self.now.sample.t)
        chain, state, news = self._signals.chain, self.now.at.state, []
        for event in self._settings.events[self._events :]:
            if event.t > t:
                break
            inputs = self._acting.environment.at(t, state)[1]
            chain, state, one = happen(event, chain, state, inputs, forest_attach)
            self._events, self._impact = self._events + 1, self._impact + one.energy_change
            news.append(replace(one, impulses=self._by_row(chain, one.impulses)))
        if news:
            self._restart(t, chain, state, news)
        else:  # torques or inputs jump
            self.begin(t, state, self.now.sample.work)

    def _by_row(self, chain: ClosedChain, impulses: Sequence[tuple[float, ...]]) -> tuple[tuple[float, ...], ...]:
        """Return impulses at a chain's grasps and loops by the rows of the run."""
        found, at = dict(zip(chain.as_forest.closures, impulses, strict=False)), (0.0,) * 6
        return tuple(found.get(row.key, at) for row in self._rows) if impulses else ()

    def _restart(self, t: float, chain: ClosedChain, state: State, news: Sequence[Occurrence]) -> None:
        """Go on with other grasps."""
        open_now = [i for i, row in self._signals.closed.items() if row.key not in chain.as_forest.closures]
        for i in open_now:
            self._tracker = self._tracker.without(i)
        for_chain = getattr(self._settings.controller, "for_chain", None)
        law = self._settings.controller if for_chain is None else for_chain(chain)
        self._use(chain, law, self._acting.memory)
        self.begin(t, state, self.now.sample.work, news)

    def _step(self, until: float, ends: bool) -> None:
        """Take a step, or a shorter one up to the first violation at which the run does not simply continue.

        Args:
            until: time at its end [s].
            ends: whether a jump follows there.
        """
        start, acting, memory = self.now, self._acting, self._acting.memory
        later = self._found(forest_step(self._engine, acting, start.sample, until))
        self._steps += 1
        crossed = np.flatnonzero((start.margins < 0.0) != (later.margins < 0.0)).tolist()
        if not crossed:
            self._accept(later, {}, ends=ends)
            return
        after, acting.memory = acting.memory, memory
        tried: dict[float, Accepted] = {until: later}

        def margin(i: int, t: float) -> float:
            if t not in tried:
                tried[t] = self._found(forest_step(self._engine, acting, start.sample, t, begins=False))
            return float(tried[t].margins[i])

        t0 = start.sample.t
        zeros = {
            i: crossing(partial(margin, i), t0, float(start.margins[i]), until, float(later.margins[i]), CROSSING)
            for i in crossed
        }
        first = min((t for i, t in zeros.items() if i in self._ending and later.margins[i] < 0.0), default=until)
        if first < until:
            later = self._found(forest_step(self._engine, acting, start.sample, first))
        else:
            acting.memory = after
        between = {t: tried[t] for t in zeros.values() if t < first}
        self._accept(later, between, ends=ends)

    def _found(self, sample: ForestSample) -> Accepted:
        """Return the forces and margins of a sample."""
        signals, found = self._signals, self._engine.account(sample.given, sample.now)
        at = mechanism_instant(signals, sample, found, self._acting.tau)
        margins = signals.margins(at) if len(signals.limited) else np.full(len(signals), np.inf)
        return Accepted(sample, found, at, margins)

    def _accept(
        self,
        later: Accepted,
        between: Mapping[float, Accepted],
        news: Sequence[Occurrence] = (),
        begins: bool = False,
        ends: bool = False,
    ) -> None:
        """Go to an instant, and take down what has happened on the way.

        Args:
            later: the instant.
            between: instants since the last one at which margins change their signs, by their times.
            news: what else has happened.
            begins: whether a smooth stretch begins there.
            ends: whether a smooth stretch ends there.
        """
        signals = self._signals
        instants = {**dict(sorted(between.items())), later.sample.t: later}
        times, margins = np.array([*instants]), np.array([one.margins for one in instants.values()])
        if between:
            entries = [(i, times, margins) for i in signals.limited.tolist()]
            self._tracker, found = self._tracker.followed(
                entries, signals, lambda t, i: signals.description(instants[t].at, i)
            )
        else:
            self._tracker, found = self._tracker.at(later.sample.t, later.margins, signals, later.at)
        self.happened += [*news, *found]
        self.now = later
        arrays = arrays_of(signals, later.sample, later.found, later.at, self._impact)
        due = begins or ends or self._steps % self._settings.recording.every == 0
        self.record.add(arrays, times.tolist(), [*margins], due, (*news, *found), begins)
        self._progress(later.sample.t)


class _Acting:
    """The arguments of a forest at a time and state; the controller's memory is updated once per step, at its start.

    Attributes:
        tau: the torques of the drives when they were last asked for.
        memory: the memory of the controller.
        environment: the chain and the wrenches on it.
    """

    def __init__(self, environment: Environment, controller: Any, memory: Any, inverse: InverseCode | None) -> None:
        self._chain, self._controller, self.memory, self._inverse = environment.chain, controller, memory, inverse
        self.environment, self._friction = environment, joint_friction(environment.chain)
        self.tau = np.zeros(0)

    def __call__(self, t: float, q: Array, qd: Array, begins: bool) -> ForestArguments:
        state = chain_state(self._chain, q, qd)
        token = inverse_code.set(self._inverse)
        try:
            tau, memory = torques_and_memory(self._controller(t, state, self.memory))
        finally:
            inverse_code.reset(token)
        self.tau = checks.numbers(tau, (self._chain.joint_count,), "controller: torques", StateError)
        if begins:
            self.memory = memory
        inputs = self.environment.at(t, state)[1]
        require_wrenches(inputs, "of a chain that is answered as a forest")
        given = mechanism_arguments(self._chain, state, self.tau, inputs)
        lost, net = friction_torque(self._friction, state.qd), given.tau.copy()
        net[joint_rows(self._chain)] -= lost
        return given._replace(tau=net)


def require_openable(chain: ClosedChain, policy: Policy) -> None:
    """Refuse to open loops, which stay closed for good.

    Raises:
        MethodNotApplicable: naming one with a contact or wrench limits.
    """
    if policy.on_slip != "release":
        return
    for row in grasp_rows(chain):
        if row.key not in chain.grasps and row.grasp is not None and conditions(row.grasp):
            raise MethodNotApplicable(
                f"on_slip: expected 'stop' or 'record' for a chain whose loop '{row.name}' has limits, since loops"
                " cannot be released"
            )
