"""The steppers of a run of a chain that is answered as a forest, and the choice among them.

As of serial chains, a whole step is one call of machine code, that of rollouts, if the law can be compiled, wrenches
are constant, and the run is long. Otherwise the forest is machine code, and the law and what acts are evaluated in
Python at every stage.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from holdfast.compiled.forest_engine import CompiledForestEngine
from holdfast.control.controller import ControlLaw, Controller
from holdfast.control.traced_law import law_key, law_of
from holdfast.dynamics.tree.forest_inverse import InverseAt
from holdfast.dynamics.tree.forest_simulate import ForestInstant, ForestReference, ForestSample
from holdfast.dynamics.tree.varied_forest import ForestArguments
from holdfast.errors import HoldfastError
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import state_of
from holdfast.simulation.adaptive import Tolerance
from holdfast.simulation.environment import Environment
from holdfast.simulation.increment import OF_WORK
from holdfast.simulation.instant import Instant
from holdfast.simulation.mechanism_moment import MechanismMoment
from holdfast.simulation.mechanism_stepper import MechanismStepper, gaps_at
from holdfast.simulation.rollout.compiled_steppers import STEPS_WORTH_COMPILING
from holdfast.simulation.rollout.fused_stepper import FusedStepper, by_name, options_for
from holdfast.simulation.rollout.kernel import StepKernel, Systems
from holdfast.simulation.rollout.rows import ACCELERATIONS, state_rows
from holdfast.simulation.rollout.traced_mechanism import flat
from holdfast.simulation.rollout.varied_mechanism import MECHANISM_STEP
from holdfast.simulation.runge_kutta import Tableau
from holdfast.simulation.step import Gaps
from holdfast.simulation.stepper import Advance
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State

WHOLE_STEPS_FROM = 1000  # steps: code of a whole step takes some ten seconds longer to compile, and saves milliseconds


@dataclass(frozen=True, eq=False, kw_only=True)
class FusedMechanismStepper(FusedStepper):
    """Takes whole steps in machine code; see `FusedStepper`. A step that fails is taken by the reference.

    Attributes:
        engine: finds what is recorded besides the motion.
        by_reference: takes the steps that fail, or says why.
    """

    engine: CompiledForestEngine
    by_reference: MechanismStepper

    def start(self, t: float, state: State, memory: Any) -> tuple[Instant, Gaps]:
        """Return the chain at a given state, closed, and the gaps before and after; see `Stepper`."""
        closed, drift = self.by_reference.closed(state)
        now = self.evaluate(t, closed, memory)
        return now, gaps_at(drift, now)

    def evaluate(self, t: float, state: State, memory: Any) -> MechanismMoment:
        """Return the chain at a given state without projection."""
        try:
            systems, (kept,) = self._at([t], [state], memory, None)
        except HoldfastError:
            return self.by_reference.evaluate(t, state, memory)
        return self.instant(systems, 0, t, kept)

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return the results of single steps; see `Stepper`."""
        found = super().advance(now, ends)
        return [one if one.failure is None else self._by_reference(now, one.t) for one in found]

    def _by_reference(self, now: Instant, end: float) -> Advance:
        (found,) = self.by_reference.advance(now, [end])
        if found.instant is None:
            return found
        return replace(found, instant=self.evaluate(end, found.instant.state, now.memory))

    def start_of(self, now: Instant, count: int = 1) -> Systems:
        """Return a number of systems at the start of steps from an instant; forces and accelerations are not set."""
        assert isinstance(now, MechanismMoment)
        systems, found = self.kernel.systems(state_rows([now.state] * count), now.memory), now.sample.now
        systems["slope"][...] = np.concatenate([found.q_rates, found.qdd, found.power])
        systems["drive"][...] = now.tau
        return systems

    def carried_at(self, now: Instant) -> Systems:
        """Return an instant as a system, with its condition and accelerations."""
        assert isinstance(now, MechanismMoment)
        systems, chain, qdd = self.start_of(now), self.environment.chain, now.accelerations
        objects, base = 6 * len(chain.free_objects), 6 * chain.floats
        parts = np.split(qdd, [base, len(qdd) - objects])
        for name, part in zip(ACCELERATIONS, (parts[1], parts[2], parts[0]), strict=True):
            if name in systems:
                systems[name][...] = part.reshape(systems[name].shape)
        systems["condition"][...] = now.sample.now.condition
        return systems

    def instant(self, systems: Systems, row: int, t: float, memory: Any) -> MechanismMoment:
        """Return one of several systems as an instant; see `FusedStepper`."""
        chain, state = self.environment.chain, state_of(systems, row)
        x = {name: array[row].copy() for name, array in systems.items()}
        forest, none, tau = chain.as_forest.forest, np.zeros(0), x["drive"]
        q_rates, qdd, power = np.split(x["slope"], [forest.position_count, len(x["slope"]) - OF_WORK])
        assert self.by_reference.constant is not None
        inputs, wrenches = self.by_reference.constant
        given = ForestArguments(forest, *flat(state), self.by_reference.drives(tau, state.qd), wrenches)
        unique, rank = self.generic_rank == forest.constraint_row_count, int(x["rank"])
        forces = x["grasp_wrench"], x.get("coupling_force", none)
        now = ForestInstant(qdd, q_rates, power, *forces, unique, float(x["condition"]), rank)
        found: Any = now
        sample, memory = ForestSample(t, given, now), x.get("memory", memory)
        return MechanismMoment(
            t, state, chain, inputs, tau, memory, found, power, None, sample, self.engine, None, x.get("margin")
        )

    def accounts(self, t: Array, arrays: Mapping[str, Array]) -> dict[str, Array]:
        """Return what a run records besides the motion, of k instants, by the names of a `ForestAccount`."""
        k, (q, qd) = len(t), _flat_rows(self.environment.chain, arrays)
        unique = self.generic_rank == self.engine.forest.constraint_row_count
        return self.engine.accounts(
            q, qd, unique, arrays["grasp_wrench"], arrays.get("coupling_force", np.zeros((k, 0)))
        )

    def _choose_forces(self, systems: Systems, t: Array) -> None:
        """Do nothing: the margins are those of the smallest forces, which are found where they are recorded."""


class MechanismSteppers:
    """Makes the steppers of a run of a chain that is answered as a forest; see `MakeStepper`.

    Its laws in Python find inverse dynamics by machine code in the engine of the last stepper that was made.
    """

    def __init__(self, steps: int) -> None:
        """Take the least number of steps of the run, by which machine code is chosen."""
        self._steps, self._engine = steps, None

    def __call__(
        self, environment: Environment, controller: Controller, rank: int, scheme: Tableau, tolerance: Tolerance
    ) -> Any:
        """Return a stepper; a negative rank is not known yet."""
        forest, of = environment.chain.as_forest.forest, (scheme, tolerance)
        reference = MechanismStepper(environment, controller, ForestReference(forest), *of)
        if rank < 0 or (self._steps < STEPS_WORTH_COMPILING and not scheme.adaptive):
            return reference
        engine = self._engine = CompiledForestEngine(forest, rank)
        whole = isinstance(environment.inputs, Inputs) and not scheme.adaptive and self._steps >= WHOLE_STEPS_FROM
        law = _compilable(controller, environment.chain) if whole else None
        if law is None or (engine.costly and rank < forest.constraint_row_count):
            return MechanismStepper(environment, controller, engine, *of)
        options = options_for(environment)
        kernel = StepKernel(environment.chain, law, scheme, rank, options=options, quick=True, code=MECHANISM_STEP)
        values, more = by_name(getattr(controller, "values", {})), {"engine": engine, "by_reference": reference}
        return FusedMechanismStepper(environment, kernel, scheme, rank, values, tolerance, **more)

    def inverse(self, given: ForestArguments) -> InverseAt | None:
        """Return inverse dynamics by machine code, if there is some for the forest; see `inverse_code`."""
        return None if self._engine is None else self._engine.inverse(given)


def _compilable(controller: Controller, chain: ClosedChain) -> ControlLaw | None:
    """Return a controller as a law that machine code can contain; None if it cannot."""
    law = law_of(controller, chain)
    return law if law is not None and law_key(law, chain) else None


def _flat_rows(chain: ClosedChain, x: Mapping[str, Array]) -> tuple[Array, Array]:
    """Return positions and rates of the chain's forest of k systems, (k, n_q) and (k, n_v); see `flat_state`."""
    pairs = (("floating_pose", "q", "object_pose"), ("floating_twist", "qd", "object_twist"))
    q, qd = (np.concatenate([x[n].reshape(len(x["q"]), -1) for n in names if n in x], axis=1) for names in pairs)
    return q, qd
