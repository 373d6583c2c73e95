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
from holdfast.dynamics.tree.closing_derivatives import POSITIONS_AND_RATES, ClosingPoint
from holdfast.dynamics.tree.forest_balance import power_into
from holdfast.dynamics.tree.forest_projection import closing_changes
from holdfast.dynamics.tree.forest_simulate import ForestInstant
from holdfast.dynamics.tree.mechanism_terms import ForestPlace, chain_arguments, chain_arrays_of, chain_results
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
    given_numbers,
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
TWISTS_AND_RATES = ("qd", "object_twist", "floating_twist")
OF_FOREST = ("qdd", "closure_wrench", "coupling_force")  # of what forward dynamics of a forest returns


class VariedNumbers(NamedTuple):
    """What varies at an instant: arguments of the forest, and numbers of the chain.

    Attributes:
        given: the arguments of the forest at the instant.
        names: names of those of its arguments that vary.
        numbers: where the numbers of the chain that vary are among the arguments of the forest.
    """

    given: ForestArguments
    names: Sequence[str]
    numbers: Sequence[ForestPlace]

    @property
    def of_forest(self) -> list[str]:
        """Names of all arguments of the forest that vary, each once."""
        return [*dict.fromkeys((*self.names, *(place.name for place in self.numbers)))]

    def gradient(self, found: Mapping[str, Array]) -> list[Array]:
        """Return the gradients by what varies, from those by arguments of the forest; q in the coordinates of qd."""
        forest, q = self.given.forest, self.given.q
        own = [by_positions(forest, q, found[name]) if name == "q" else found[name] for name in self.names]
        return own + [place.of(found) for place in self.numbers]

    def along(self, rates: Sequence[Array]) -> dict[str, Array]:
        """Return rates of arguments of the forest, from those of what varies."""
        forest, q, values = self.given.forest, self.given.q, self.given.values(self.of_forest)
        found = {name: np.zeros(np.shape(x), dtype=object) for name, x in values.items()}
        for name, rate in zip(self.names, rates, strict=False):
            found[name] = rates_of_positions(forest, q, rate) if name == "q" else rate
        for place, rate in zip(self.numbers, rates[len(self.names) :], strict=True):
            place.add(np.asarray(rate), found)
        return found


class ForwardRule(NamedTuple):
    """Derivatives of `OF_FOREST` by what varies, at a solution."""

    solved: TracedSolution
    varied: VariedNumbers

    def rates(self, *given: Array) -> Sequence[Array]:
        """Return the rates of the results for given rates of what varies."""
        along = {name: x[..., None] for name, x in self.varied.along(given).items()}
        found = rates(self.solved, along)
        return [found[name][..., 0] for name in OF_FOREST]

    def gradient(self, *cotangents: Array) -> Sequence[Array]:
        """Return the gradient of sum(cotangent . result) with respect to what varies."""
        of: dict[str, Array] = dict(zip(OF_FOREST, cotangents, strict=True))
        return self.varied.gradient(gradients(self.solved, of, self.varied.of_forest))


class ClosingRule(NamedTuple):
    """Derivatives of the changes of positions and rates in a closing round, by what varies."""

    at: ClosingPoint
    varied: VariedNumbers

    def rates(self, *given: Array) -> Sequence[Array]:
        """Return the rates of the changes for given rates of what varies."""
        return self.at.forward(self.varied.along(given))

    def gradient(self, *cotangents: Array) -> Sequence[Array]:
        """Return the gradient of sum(cotangent . change) with respect to what varies."""
        return self.varied.gradient(self.at.backward(cotangents, self.varied.of_forest))


class VariedForest(TracedForest):
    """A forest in a step some of whose numbers carry derivatives.

    Attributes:
        working: whether the derivatives of the work are computed.
        tangents: of numbers of the chain, with where these are among the arguments of the forest.
    """

    def __init__(
        self,
        forest: Forest,
        rank: int,
        made: Forest,
        taker: Loops | None,
        tangents: Sequence[tuple[ForestPlace, Array]],
    ) -> None:
        super().__init__(forest, rank, made)
        self.tangents = tangents
        self.working, self._taker, self._of = False, taker, forest

    def instant(self, given: ForestArguments) -> ForestInstant:
        """See `StepEngine`."""
        arguments = {"q": given.q, "qd": given.qd, "tau": given.tau, "link_wrench": given.wrenches}
        varied = {name: x for name, x in arguments.items() if is_recorded(x)}
        with loops_by(self._taker):
            solved = traced_solution(self._of, {name: bare(x) for name, x in arguments.items()}, self.forest)
            x = forward_outputs(solved)
        rule = ForwardRule(solved, self._varied(solved.given, [*varied]))
        qdd, wrenches, forces = by_rule([x[n] for n in OF_FOREST], rule, *varied.values(), *self._numbers_of(""))
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
            rule = ClosingRule(at, self._varied(given, POSITIONS_AND_RATES, "link"))
            step, change = by_rule(now.changes, rule, q, qd, *self._numbers_of("link"))
            q, qd = displaced(self.forest, q, step), qd + change
        return q, qd, (0.0, 0.0)

    def _varied(self, given: ForestArguments, names: Sequence[str], of: str = "") -> VariedNumbers:
        return VariedNumbers(given, names, [place for place, _ in self.tangents if place.name.startswith(of)])

    def _numbers_of(self, of: str) -> list[Array]:
        return [x for place, x in self.tangents if place.name.startswith(of)]


class VariedMechanism(MechanismSystem):
    """A system of a chain that is answered as a forest, some of whose numbers carry derivatives; see `VariedSystem`."""

    positions_are_turned = True

    def __init__(self, of: VariedStep, given: Given, varied: Mapping[str, Array], taker: Loops | None) -> None:
        chain = of.model.structure.chain
        fields = state_fields(chain)
        own = own_numbers(varied) | {n: given[n] + varied[n] for n in INPUT_FIELDS if n in varied}
        own |= {f"last.{name}": varied[name] for name in TWISTS_AND_RATES if name in varied}
        state = State(**{field: given[f"last.{name}"] for name, field in fields.items()})
        forest, q = chain.as_forest.forest, flat(state)[0]
        turned, places = np.zeros(forest.velocity_count, dtype=object), chain_arguments(chain)
        for name in {*POSITIONS} & {*varied}:
            turned[places[name].rows] = varied[name].ravel()
        moved = chain_arrays_of(chain, q + position_rates(forest, q, turned), turned)
        own |= {f"last.{name}": moved[field] for name, field in fields.items() if name in POSITIONS}
        super().__init__(of.model, {**given, **own})
        tangents = [(places[name], varied[name]) for name in given_numbers(chain) if name in varied]
        rank, made = self.engine.rank, self.engine.forest
        self.engine: VariedForest = VariedForest(forest, rank, made, taker, tangents)

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
