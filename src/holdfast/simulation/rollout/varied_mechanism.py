"""Linearisation of a time step of a chain that is answered as a forest; see `varied_step`.

Forward dynamics and each closing round are differentiated by one additional solve with the factors at hand
(`forest_derivatives`, `closing_derivatives`), all other operations one by one. Positions are varied in the coordinates
of the rates: quaternions turn from the left.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from holdfast.compiled.forest_schedule import (
    LimbedEquations,
    TracedSolution,
    forward_outputs,
    gradients,
    rates,
    traced_solution,
    with_constant_arms,
)
from holdfast.compiled.traced_chain import Given
from holdfast.compiled.traced_forest import CLOSING_ROUNDS, TracedForest
from holdfast.dynamics.tree.closing_derivatives import ClosingPoint
from holdfast.dynamics.tree.forest_balance import power_into
from holdfast.dynamics.tree.forest_projection import closing_changes
from holdfast.dynamics.tree.forest_simulate import ForestInstant
from holdfast.dynamics.tree.mechanism_terms import chain_arguments, chain_arrays_of, chain_results
from holdfast.dynamics.tree.varied_forest import (
    ForestArguments,
    by_positions,
    displaced,
    position_rates,
    rates_of_positions,
)
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.forest import Forest
from holdfast.questions.arrays import Shape, state_fields
from holdfast.simulation.increment import OF_WORK
from holdfast.simulation.rollout.step_code import StepCode
from holdfast.simulation.rollout.traced_mechanism import (
    MechanismEvaluation,
    MechanismSystem,
    flat,
    mechanism_externals,
    mechanism_functions,
    mechanism_parameters,
    mechanism_shapes,
    mechanism_structure,
)
from holdfast.simulation.rollout.varied_step import INPUT_FIELDS, OfStep, VariedStep, loops_by, own_numbers
from holdfast.simulation.runge_kutta import Tableau
from holdfast.spatial.differentiation import bare, by_rule, is_recorded
from holdfast.spatial.scalar import Array, Loops, Scalar
from holdfast.state import State

POSITIONS = ("q", "object_pose", "floating_pose")  # arrays of a state
RATES = ("qd", "object_twist", "floating_twist")
FORCES = ("qdd", "closure_wrench", "coupling_force")  # of what forward dynamics of a forest returns


class ForwardRule(NamedTuple):
    """Derivatives of `FORCES` by some of the arguments of a forest, at its solution."""

    solved: TracedSolution
    names: tuple[str, ...]

    def rates(self, *given: Array) -> Sequence[Array]:
        """Return the rates of the results for given rates of the arguments."""
        forest, q = self.solved.given.forest, self.solved.given.q
        along = dict(zip(self.names, given, strict=True))
        along |= {"q": rates_of_positions(forest, q, along["q"])} if "q" in along else {}
        found = rates(self.solved, {name: x[..., None] for name, x in along.items()})
        return [found[name][..., 0] for name in FORCES]

    def gradient(self, *cotangents: Array) -> Sequence[Array]:
        """Return the gradient of sum(cotangent . result) with respect to every argument."""
        found = gradients(self.solved, dict(zip(FORCES, cotangents, strict=True)), self.names)
        forest, q = self.solved.given.forest, self.solved.given.q
        return [by_positions(forest, q, x) if name == "q" else x for name, x in found.items()]


class ClosingRule(NamedTuple):
    """Derivatives of the changes of positions and rates in a closing round, by both."""

    at: ClosingPoint

    def rates(self, of_q: Array, of_qd: Array) -> Sequence[Array]:
        """Return the rates of the changes for given rates of positions and rates."""
        return self.at.forward(rates_of_positions(self.at.given.forest, self.at.given.q, of_q), of_qd)

    def gradient(self, *cotangents: Array) -> Sequence[Array]:
        """Return the gradient of sum(cotangent . change) with respect to positions and rates."""
        by_q, by_qd = self.at.backward(cotangents)
        return by_positions(self.at.given.forest, self.at.given.q, by_q), by_qd


class VariedForest(TracedForest):
    """A forest in a step some of whose numbers carry derivatives.

    Attributes:
        working: whether the derivatives of the work are computed.
    """

    def __init__(self, forest: Forest, rank: int, made: Forest, taker: Loops | None) -> None:
        super().__init__(forest, rank, made)
        self.working, self._taker, self._of = False, taker, forest

    def instant(self, given: ForestArguments) -> ForestInstant:
        """See `StepEngine`."""
        arguments = {"q": given.q, "qd": given.qd, "tau": given.tau, "link_wrench": given.wrenches}
        varied = {name: x for name, x in arguments.items() if is_recorded(x)}
        with loops_by(self._taker):
            solved = traced_solution(self._of, {name: bare(x) for name, x in arguments.items()}, self.forest)
            x = forward_outputs(solved)
        qdd, wrenches, forces = by_rule([x[n] for n in FORCES], ForwardRule(solved, (*varied,)), *varied.values())
        power = np.array(power_into(given, given.motion({}))) if self.working else np.zeros(OF_WORK)
        q_rates = position_rates(self.forest, given.q, given.qd)
        return ForestInstant(qdd, q_rates, power, wrenches, forces, self.unique, 1.0, self.rank)

    def closed(self, q: Array, qd: Array) -> tuple[Array, Array, tuple[Scalar, Scalar]]:
        """See `StepEngine`; of the gaps nothing is differentiated."""
        arms, none = with_constant_arms(self._of), np.zeros((len(self._of.bodies), 6))
        for _ in range(CLOSING_ROUNDS):
            here, rates = bare(q), bare(qd)
            with loops_by(self._taker):
                now = closing_changes(self.forest, here, rates, arms)
            equations = LimbedEquations(now.limbed, now.factors)
            given = ForestArguments(self.forest, here, rates, 0.0 * rates, none)
            at = ClosingPoint(given, [equations.unknowns(x) for x in now.found], equations.at_rest)
            step, change = by_rule(now.changes, ClosingRule(at), q, qd)
            q, qd = displaced(self.forest, q, step), qd + change
        return q, qd, (0.0, 0.0)


class VariedMechanism(MechanismSystem):
    """A system of a chain that is answered as a forest, some of whose numbers carry derivatives; see `VariedSystem`."""

    positions_are_turned = True

    def __init__(self, of: VariedStep, given: Given, varied: Mapping[str, Array], taker: Loops | None) -> None:
        chain = of.model.structure.chain
        fields = state_fields(chain)
        own = own_numbers(varied) | {n: given[n] + varied[n] for n in INPUT_FIELDS if n in varied}
        own |= {f"last.{name}": varied[name] for name in RATES if name in varied}
        state = State(**{field: given[f"last.{name}"] for name, field in fields.items()})
        forest, q = chain.as_forest.forest, flat(state)[0]
        turned, places = np.zeros(forest.velocity_count, dtype=object), chain_arguments(chain)
        for name in {*POSITIONS} & {*varied}:
            turned[places[name].rows] = varied[name].ravel()
        moved = chain_arrays_of(chain, q + position_rates(forest, q, turned), turned)
        own |= {f"last.{name}": moved[field] for name, field in fields.items() if name in POSITIONS}
        super().__init__(of.model, {**given, **own})
        self.engine: VariedForest = VariedForest(forest, self.engine.rank, self.engine.forest, taker)

    @staticmethod
    def shapes(chain: ClosedChain) -> dict[str, Shape]:
        """Return the shapes of gradients with respect to the arguments."""
        return {name: place.shape for name, place in chain_arguments(chain).items()}

    @staticmethod
    def results_of(chain: ClosedChain) -> tuple[str, ...]:
        """Return the names of results of forward dynamics."""
        return tuple(chain_results(chain))

    def through(self, tableau: Tableau, working: bool) -> OfStep:
        """Return the step."""
        self.engine.working = working
        now = self.evaluate(self.time(0.0), self.state, self.last("before"), choose=False)
        step = self.stepped(tableau, now.slope(), now.memory)
        self.engine.working = False
        return OfStep(now.memory, self.found_at(step.q, step.qd), step.work)

    def closed(self, t: Scalar, state: State) -> State:
        """Return a state brought back to grasps, loops and couplings."""
        return self.found_at(*self.engine.closed(*flat(state))[:2])

    def end_arrays(self, state: State) -> dict[str, Array]:
        """Return the arrays of a state, of which the rates of positions are in the coordinates of qd."""
        places, (q, qd) = chain_arguments(self.real), flat(state)
        whole = {"q": rates_of_positions(self.engine.forest, bare(q), q), "qd": qd}
        return {name: places[name].of(whole) for name in state_fields(self.real)}

    def result(self, name: str, at: MechanismEvaluation) -> Array:
        """Return a result of forward dynamics at the step's end."""
        return self.solution(at)[name]


MECHANISM_STEP = StepCode(
    mechanism_structure,
    mechanism_shapes,
    mechanism_externals,
    mechanism_parameters,
    mechanism_functions,
    VariedMechanism,
    constant=True,
)
