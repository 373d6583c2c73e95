"""The traced time step of a chain that is answered as a forest: the step of `simulate`, by an engine that is traced."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from holdfast.compiled.forest_schedule import with_constants
from holdfast.compiled.structure import Options, Structure
from holdfast.compiled.traced_chain import Given, externals
from holdfast.compiled.traced_forest import TracedForest
from holdfast.compiler.program import Shape
from holdfast.compiler.schedule import External
from holdfast.control.controller import ControlLaw
from holdfast.control.sampled import within_steps
from holdfast.dynamics.projection import Gap
from holdfast.dynamics.tree.forest_gaps import position_gaps, velocity_gaps
from holdfast.dynamics.tree.forest_simulate import ForestInstant, ForestSample, ForestStep, forest_step
from holdfast.dynamics.tree.mechanism_terms import (
    body_wrenches,
    chain_arrays_of,
    chain_results,
    driven_joints,
    flat_rates,
    joint_rows,
)
from holdfast.dynamics.tree.varied_forest import ForestArguments
from holdfast.forces.margins import joint_coordinates, joint_limits
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.fingerprint import code_key, digest_of
from holdfast.model.forest import Forest
from holdfast.questions.arrays import CONTACTS, FLOATING_RESULT, contact_of, shapes, state_fields, value_of
from holdfast.questions.case import varied_body
from holdfast.simulation.environment import Environment
from holdfast.simulation.increment import OF_WORK
from holdfast.simulation.joint_friction import friction_torque
from holdfast.simulation.mechanism_stepper import increment
from holdfast.simulation.rollout.step_code import STEP_INPUTS, StepFunctions, carried_externals, own_shapes
from holdfast.simulation.rollout.traced_step import StepModel, TracedSystem, evaluation_of, step_of
from holdfast.simulation.runge_kutta import Tableau
from holdfast.simulation.step import StepResult
from holdfast.spatial.frozen import changed
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, select, where
from holdfast.state import Inputs, State, found_state

OBJECT_NUMBERS = ("object_mass", "object_com", "object_inertia")
OF_MECHANISM = ("qdd", "object_acceleration", "grasp_wrench", "coupling_force")


@dataclass(frozen=True, eq=False)
class MechanismStructure(Structure):
    """A chain that is answered as a forest, as the compiler sees it.

    Attributes:
        rank: rank of its constraint; None if it is not known yet, and full rank is assumed.
    """

    rank: int | None = None

    @cached_property
    def key(self) -> str:
        """A digest of everything on which the code depends."""
        chain = self.chain
        layout = chain.floats, len(chain.free_objects), chain.position_count, [*chain.as_forest.closures]
        forest = code_key(chain.as_forest.forest)
        return digest_of([forest.encode(), repr((self.options, self.rank, layout)).encode()])


class MechanismEvaluation(NamedTuple):
    """The evaluation of a system at one state.

    Attributes:
        state: positions and velocities.
        given: the arguments of its forest.
        now: what is found there.
        drive: (n,) torques of the law.
        memory: memory that the law has returned.
    """

    state: State
    given: ForestArguments
    now: ForestInstant
    drive: Array
    memory: Array

    def slope(self, turns: object = None) -> Array:
        """Return the rates of positions, velocities and works, as those of `forest_step`."""
        return concatenate([self.now.q_rates, self.now.qdd, self.now.power])


class MechanismSystem(TracedSystem):
    """One system of a chain that is answered as a forest, during the tracing of a step."""

    def __init__(self, model: StepModel, given: Given) -> None:
        structure = model.structure
        assert isinstance(structure, MechanismStructure)
        chain = structure.chain
        none = np.zeros((len(chain.free_objects), 6))
        wrenches = given.get("object_wrench", none), given.get("link_wrench")
        acting = Inputs(*wrenches, trunk_link_wrenches=given.get("trunk_link_wrench"))
        super().__init__(model, given, Environment(chain, {}, acting))
        forest = chain.as_forest.forest
        rank = forest.constraint_row_count if structure.rank is None else structure.rank
        self.engine = TracedForest(forest, rank, with_given(chain, given))
        self._undriven = ~driven_joints(chain)

    def evaluate(
        self,
        t: Scalar,
        state: State,
        memory: Array,
        choose: bool,
        implicit: object = None,
        law: ControlLaw | None = None,
    ) -> Any:
        """Return torques, accelerations, forces and power; see `TracedSystem.evaluate`."""
        given, drive, kept = self._acting(t, state, memory, law or self.law)
        now = self.engine.instant(given)
        self.worst = self.engine.worst
        return MechanismEvaluation(state, given, now, drive, kept)

    def step_from(self, tableau: Tableau, first: Array) -> StepResult:
        """Return the result of a step that begins with the slope `first`; if `held` is set, the state stays."""
        memory, still = self.last("memory"), self.given["held"][()] > 0.5
        step = self.stepped(tableau, first, memory)
        q, qd = (select(still, *pair) for pair in zip(flat(self.state), (step.q, step.qd), strict=True))
        end = self.evaluate(self.time(1.0), self.found_at(q, qd), memory, True)
        motion = end.given.motion({})
        left = Gap(position_gaps(motion, q).largest, velocity_gaps(motion, qd).largest)
        return StepResult(end, (Gap(*step.drift), left), step.work, step.estimates)

    def stepped(self, tableau: Tableau, first: Array, memory: Array) -> ForestStep:
        """Return a step that begins with the slope `first`, with the memory that the law is given."""
        chain, begin, law = self.real, self.state, within_steps(self.law)
        positions = chain.as_forest.forest.position_count
        q_rates, qdd, power = np.split(first, [positions, len(first) - OF_WORK])
        none = np.zeros(0)
        now = ForestInstant(qdd, q_rates, power, none, none, self.engine.unique, 1.0, self.engine.rank)
        start = ForestArguments(self.engine.forest, *flat(begin), none, none)

        def acting(later: Scalar, q: Array, qd: Array) -> ForestArguments:
            return self._acting(self.time(0.0) + later, self.found_at(q, qd), memory, law)[0]

        sample, h = ForestSample(0.0, start, now), self.given["step"][()]
        return forest_step(self.engine, acting, sample, h, partial(increment, tableau))

    def results(self, now: MechanismEvaluation) -> dict[str, Array]:
        """Return what is known at a step's end, by the names of carried arrays."""
        kept = {name: getattr(now.state, field) for name, field in state_fields(self.real).items()}
        kept |= {"slope": now.slope(), "drive": now.drive, "memory": now.memory} | self.solution(now)
        kept |= {"rank": array(now.now.rank), "condition": array(now.now.condition)}
        return kept | {"margin": self.margins(now)}

    def solution(self, now: MechanismEvaluation) -> dict[str, Array]:
        """Return the results of forward dynamics."""
        chain, found = self.real, now.now
        joints, count = joint_rows(chain), 6 * len(chain.free_objects)
        of_objects = chain_results(chain)["object_acceleration"].shape
        kept = {"qdd": found.qdd[joints]}
        kept["object_acceleration"] = found.qdd[len(found.qdd) - count :].reshape(of_objects)
        kept |= {FLOATING_RESULT: found.qdd[: joints.start]} if chain.floats else {}
        return kept | {"grasp_wrench": found.closure_wrench, "coupling_force": found.coupling_force}

    def margins(self, now: MechanismEvaluation) -> Array:
        """Return the margins of grasps and loops, (closures,) [N]."""
        return self.engine.margins(now.given, now.now, self.given[CONTACTS])

    def passes_singular(self, tableau: Tableau, end: State, drift: Gap) -> Scalar:
        """Return 0: as in `simulate`, singular configurations within a step are not looked for."""
        return 0.0

    def velocities(self, state: State) -> Array:
        """Return the rates of the forest, (n_v,)."""
        return flat(state)[1]

    def accelerations(self, state: State, slope: Array) -> Array:
        """Return their time derivatives in a slope, (n_v,)."""
        return slope[self.engine.forest.position_count : len(slope) - OF_WORK]

    def coordinates(self, q: Array) -> Array:
        """Return the positions of the joints in the order of their rates, (n,)."""
        return joint_coordinates(self.real, q)

    def found_at(self, q: Array, qd: Array) -> State:
        """Return the state of the chain from positions and rates of its forest."""
        return found_state(chain_arrays_of(self.real, q, qd))

    def _acting(self, t: Scalar, state: State, memory: Array, law: ControlLaw) -> tuple[ForestArguments, Array, Array]:
        """Return the arguments of the forest, torques, which are not numbers if a passive joint has one, and memory."""
        drive, kept = self.torques(law, t, state, memory)
        tau = [where(abs(x) <= 0.0, 0.0, np.nan) if no else x for x, no in zip(drive, self._undriven, strict=True)]
        net = array(tau) - friction_torque(self.friction, state.qd) if self.friction.any() else array(tau)
        _, inputs = self.surroundings(t, state)
        drives = flat_rates(net, 0.0 * state.object_twist, None if state.base_twist is None else np.zeros(6))
        wrenches = body_wrenches(self.real, inputs.shaped(self.real))
        return ForestArguments(self.engine.forest, *flat(state), drives, wrenches), drive, kept


def step(model: StepModel, tableau: Tableau, given: Given) -> dict[str, Any]:
    """Return the carried arrays of a system after a step; see `traced_step.step`."""
    return step_of(MechanismSystem(model, given), tableau)


def evaluation(model: StepModel, given: Given) -> dict[str, Array]:
    """Return the slope at the current state with new inputs; see `traced_step.evaluation`."""
    return evaluation_of(MechanismSystem(model, given))


def given_numbers(chain: ClosedChain) -> tuple[str, ...]:
    """Return the names of the numbers of a chain that are no constants: gravity, and those of an only object."""
    return ("gravity", *(OBJECT_NUMBERS if chain.held_object is not None and len(chain.free_objects) == 1 else ()))


def with_given(chain: ClosedChain, given: Given) -> Forest:
    """Return a chain's forest with constants and `given_numbers` as its numbers."""
    made = with_constants(chain.as_forest.forest)
    *others, last = made.bodies  # an object comes last
    if OBJECT_NUMBERS[0] in given_numbers(chain):
        last = changed(last, link=varied_body(last.link, "object", given, ()))
    return changed(made, bodies=(*others, last), gravity=given["gravity"])


def flat(state: State) -> tuple[Array, Array]:
    """Return positions and rates in the order of the bodies of a chain's forest."""
    return (
        flat_rates(state.q, state.object_pose, state.base_pose),
        flat_rates(state.qd, state.object_twist, state.base_twist),
    )


def mechanism_structure(chain: ClosedChain, options: Options, generic_rank: int) -> Structure:
    """Return what the compiler sees of a chain; see `StepCode`."""
    options = replace(options, held=0 <= generic_rank < chain.as_forest.forest.constraint_row_count)
    return MechanismStructure(chain, options, rank=generic_rank if generic_rank >= 0 else None)


def mechanism_shapes(chain: ClosedChain, law: ControlLaw, options: Options) -> dict[str, Shape]:
    """Return the shapes of the arrays that a system carries between two steps; see `StepCode`."""
    forest, known = chain.as_forest.forest, shapes(chain)
    own = own_shapes(chain.joint_count, len(forest.closures), len(law.memory), options)
    own["slope"] = (forest.position_count + forest.velocity_count + OF_WORK,)
    names = [*state_fields(chain), *OF_MECHANISM, *([FLOATING_RESULT] if chain.floats else [])]
    states = {name: known[name] for name in names}
    found = {**states, **own}
    return {name: shape for name, shape in found.items() if math.prod(shape) or name in states}


def mechanism_externals(structure: Structure, law: ControlLaw, states: Mapping[str, Shape]) -> dict[str, External]:
    """Return the arrays of a step; see `StepCode`."""
    chain, options = structure.chain, structure.options
    known = shapes(chain)
    own: dict[str, Shape] = {**dict.fromkeys((*STEP_INPUTS, "notice"), ()), "limits": (4, chain.joint_count)}
    of_law = {f"control.{name}": tuple(shape) for name, shape in law.parameters.items()}
    wrenches = ["object_wrench", *(["link_wrench", "trunk_link_wrench"] if options.link_wrenches else [])]
    inputs = [*STEP_INPUTS, *(name for name in wrenches if math.prod(known[name])), *of_law]
    inputs += ["notice"] if options.resolution else []
    parameters = [*given_numbers(chain), "limits", CONTACTS]
    return externals(inputs, parameters, (), known | own | of_law) | carried_externals(states)


def mechanism_parameters(chain: ClosedChain, generic_rank: int) -> dict[str, Array]:
    """Return a chain's own parameters; see `StepCode`."""
    closures = chain.as_forest.forest.closures
    contacts = np.array([contact_of(closure.grasp) for closure in closures]).reshape(len(closures), 7)
    own = {name: np.array(value_of(name, chain)) for name in given_numbers(chain)}
    return own | {"limits": np.array(joint_limits(chain)), CONTACTS: contacts}


def mechanism_functions(model: StepModel, tableau: Tableau) -> StepFunctions:
    """Return the functions of a step; see `StepCode`."""
    return partial(step, model, tableau), partial(evaluation, model), None
