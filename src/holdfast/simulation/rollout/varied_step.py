"""Linearisation of a time step, by running the code of the step on numbers that carry derivatives.

Forward dynamics and each iteration of the projection are differentiated by one additional solve
(`dynamics.derivatives.PointRule`). All other operations, those of the law included, are differentiated one by one. Both
iterations of the projection are differentiated as they are computed, because the derivative of the converged projection
would differ by the order of the step's drift.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from holdfast.compiled.forward_schedule import SolutionWithStatus, solve_with_status
from holdfast.compiled.parameters import WRENCHES
from holdfast.compiled.traced_chain import Given, framed
from holdfast.dynamics.closed.chain_solution import ChainSolution
from holdfast.dynamics.closed.force_elements import with_force_elements, without_force_elements
from holdfast.dynamics.closed.second_solve import Point, point
from holdfast.dynamics.derivatives import PointRule, by_pose, motion_of
from holdfast.dynamics.projection import STEP_ROUNDS, Change, displaced_by, quickened, turned_and_shifted
from holdfast.dynamics.projection_derivatives import OF_PROJECTION, OF_ROUND, change_of, impulse_point, round_point
from holdfast.forces.margins import limited_margins
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import CONTACTS, gradient_shapes, results_of, state_fields
from holdfast.questions.case import VariedCase
from holdfast.simulation.environment import Environment
from holdfast.simulation.increment import OF_WORK, no_turns
from holdfast.simulation.linearly_implicit import Implicit
from holdfast.simulation.rollout.traced_step import Evaluation, StepModel, TracedSystem
from holdfast.simulation.rollout.user_functions import WRENCH_FIELDS
from holdfast.simulation.runge_kutta import Tableau
from holdfast.simulation.step import EndRequest, EvaluationRequest, StageRequest
from holdfast.spatial.differentiation import bare, by_rule, is_recorded, linearised
from holdfast.spatial.linear import Linear
from holdfast.spatial.scalar import Array, Loops, Scalar, loops
from holdfast.state import Inputs, State, parts_of

STATE_POSES = ("object_pose", "floating_pose")
INPUT_FIELDS: dict[str, str] = dict(zip(("object_wrench", *WRENCHES), WRENCH_FIELDS, strict=True))
OTHER_FIELDS = {"floating_acceleration": "base_acceleration"}  # results that a solution calls otherwise
MARGIN_RESULT, WORK_RESULT = "margin", "work"  # results of a step that are not of forward dynamics
LAW_PREFIX = "control."  # prefix of the names of the law's parameters


class OfStep(NamedTuple):
    """A step of a system in which some of the numbers carry derivatives.

    Attributes:
        memory: the law's memory during the step.
        end: the state at its end.
        work: (4,) work during the step.
    """

    memory: Array
    end: State
    work: Array


class VariedSystem(TracedSystem):
    """A system in which some of the numbers carry derivatives.

    Attributes:
        varied: the varied numbers by name; for parameters of the model and for inputs, these are zero tangents.
        memory: the law's memory during the step.
        many: as in `VariedStep`.
        working: whether the derivatives of the work are computed.
        positions_are_turned: whether rates of all positions are in the coordinates of the rates of the chain, where it
            varies and where it arrives; otherwise those of poses at the end are those of their numbers.
        heavier: (n,) armature added in a stage of a linearly implicit step; None in other stages.
        taker: runs the loops inside forward dynamics; the loops of the step itself are Python loops.
    """

    positions_are_turned = False
    shapes = staticmethod(gradient_shapes)  # of gradients with respect to the arguments
    results_of = staticmethod(results_of)  # names of results of forward dynamics

    def __init__(self, of: VariedStep, given: Given, varied: Mapping[str, Array], taker: Loops | None) -> None:
        super().__init__(of.model, given, of.environment)
        own = own_numbers(varied)
        for name in state_fields(self.real):
            if name in varied:
                last = given[f"last.{name}"]
                own[f"last.{name}"] = turned_and_shifted(last, varied[name]) if name in STATE_POSES else varied[name]
        self.given, self.varied, self.taker = {**given, **own}, varied, taker
        self.heavier: Array | None = None
        self.memory, self.many, self.working = self.last("before"), of.many, False

    def plain(self, implicit: Implicit | None) -> Implicit | None:
        """Return the additional armatures without their derivatives, which `solve` takes from `heavier`."""
        self.heavier = None if implicit is None else implicit.armature
        return None if implicit is None else implicit._replace(armature=bare(implicit.armature))

    def solve(
        self, chain: ClosedChain, state: State, tau: Array, inputs: Inputs, held: Array | None, choose: bool
    ) -> SolutionWithStatus:
        """Return forward dynamics, with its derivatives."""
        if chain.springs:
            chain, inputs = without_force_elements(chain), self._with_springs(chain, state, inputs)
        pushed = self._pushed(inputs)
        acting = replace(inputs, **{INPUT_FIELDS[name]: bare(x) for name, x in pushed.items()})
        with loops_by(self.taker):
            rank = self.given["generic_rank"]
            found = solve_with_status(chain, framed(plain(state)), bare(tau), acting, rank, self.route, held, choose)
            at = point(found.motion, found.found, self.route)
        fields = {name: OTHER_FIELDS.get(name, name) for name in results_of(chain)}
        results = {name: np.asarray(getattr(found.whole, field)) for name, field in fields.items()}
        arguments = self.model() | state_arrays(self.real, state) | pushed | {"tau": tau}
        arguments |= {} if self.heavier is None else {"armature": self.heavier}
        made = ruled(at, {name: x for name, x in results.items() if x.size}, arguments, self.many)
        return found._replace(whole=found.whole._replace(**{fields[name]: x for name, x in made.items()}))

    def _pushed(self, inputs: Inputs) -> dict[str, Array]:
        """Return the external wrenches by name: those of the inputs, plus their variations if they are varied."""
        pushed = {name: x for name, field in INPUT_FIELDS.items() if (x := getattr(inputs, field)) is not None}
        return {name: x + self.varied[name] if name in self.varied else x for name, x in pushed.items()}

    def _with_springs(self, chain: ClosedChain, state: State, inputs: Inputs) -> Inputs:
        """Return the inputs with the wrenches of springs between bodies, which vary with the state and the bases."""
        case = self._case(chain, state, inputs, ("base",))
        return with_force_elements(case.chain, case.state, inputs)

    def _case(self, chain: ClosedChain, state: State, inputs: Inputs, moved: Sequence[str]) -> VariedCase:
        """Return a chain at a state, both of which vary; `moved` as in `VariedCase.with_varied`."""
        case = VariedCase(chain, framed(State(**parts_of(state))), inputs, {})
        for what in moved:
            if (name := f"{what}_pose") in self.varied:
                case = case.with_varied(what, self.varied[name])
        return case

    def power(
        self, chain: ClosedChain, state: State, drive: Array, lost: Array, inputs: Inputs, whole: ChainSolution
    ) -> Array:
        """Return the power (4,); zeros where no derivatives of the work are needed."""
        if not self.working:
            return np.zeros(OF_WORK)
        acting = replace(inputs, **{INPUT_FIELDS[name]: x for name, x in self._pushed(inputs).items()})
        case = self._case(chain, state, acting, ("base", "grasp"))
        return super().power(case.chain, case.state, drive, lost, acting, whole)

    def through(self, tableau: Tableau, working: bool) -> OfStep:
        """Return the step."""
        self.working = working
        now = self.evaluate(self.time(0.0), self.state, self.last("before"), choose=False)
        self.memory = now.memory
        end, _, work, _ = self.step_from(tableau, now.slope(no_turns(now.state)))
        self.working = False
        return OfStep(now.memory, end, work)

    def end_arrays(self, state: State) -> dict[str, Array]:
        """Return the arrays of a state."""
        return state_arrays(self.real, state)

    def result(self, name: str, at: Evaluation) -> Array:
        """Return a result of forward dynamics at the step's end."""
        return getattr(at.found.whole, OTHER_FIELDS.get(name, name))

    def margins(self, at: Evaluation) -> Array:
        """Return the margins of the grasps, (grasps,)."""
        case = self._case(self.environment.chain, at.state, Inputs(), ("grasp",))
        R = case.state.object_frame.R
        return limited_margins(case.chain, self.given[CONTACTS], R, at.found.whole.grasp_wrench)

    def handle(self, request: EvaluationRequest) -> Any:
        """Return the reply to a request of a step; at the end it is the state."""
        t, at = request.t, request.state
        if isinstance(request, StageRequest):
            return self.at_stage(request, at, self.memory)
        return at if isinstance(request, EndRequest) else (self.closed(t, at), None)

    def closed(self, t: Scalar, state: State) -> State:
        """Return a state projected onto the grasps; see `projection.after_step`."""
        for _ in range(STEP_ROUNDS):
            state = displaced_by(state, self._change(t, state, round_point, OF_ROUND))
        return quickened(state, self._change(t, state, impulse_point, OF_PROJECTION))

    def model(self) -> dict[str, Array]:
        """Return the varied parameters of the model."""
        beside = (*state_fields(self.real), *INPUT_FIELDS, "before", "step")
        return {name: x for name, x in self.varied.items() if name not in beside and not name.startswith(LAW_PREFIX)}

    def _change(self, t: Scalar, state: State, project: Callable[..., Point], by: Sequence[str]) -> Change:
        here = framed(plain(state))
        chain, inputs = self.environment.at(t, here)
        with loops_by(self.taker):
            at = project(chain, here, inputs, self.held, self.route)
        found = change_of(at)
        results = {"qdd": found.qd, "object_acceleration": found.object}
        results |= {} if found.base is None else {"floating_acceleration": found.base}
        arguments = self.model() | state_arrays(self.real, state)
        made = ruled(at, results, {name: x for name, x in arguments.items() if name in by}, self.many)
        return Change(made["qdd"], made["object_acceleration"], made.get("floating_acceleration"))


def own_numbers(varied: Mapping[str, Array]) -> dict[str, Array]:
    """Return what the law and the step are given in place of their own numbers."""
    own = {name: x for name, x in varied.items() if name.startswith(LAW_PREFIX)}
    own |= {"last.before": varied["before"]} if "before" in varied else {}
    return own | ({"step": varied["step"]} if "step" in varied else {})


@contextmanager
def loops_by(taker: Loops | None) -> Iterator[None]:
    """Within this context, `taker` runs the loops over arms, grasps and links; None stands for Python."""
    token = loops.set(taker)
    try:
        yield
    finally:
        loops.reset(token)


def ruled(
    at: Point, results: Mapping[str, Array], arguments: Mapping[str, Array], many: bool = False
) -> dict[str, Array]:
    """Return the results at a point, with their derivatives with respect to the varied arguments."""
    varied = {name: x for name, x in arguments.items() if is_recorded(x)}
    poses = {name: bare(varied[name]) for name in STATE_POSES if name in varied}
    rule = PointRule(at, {name: x.shape for name, x in results.items()}, tuple(varied), poses)
    return dict(
        zip(results, by_rule(list(results.values()), rule.whole() if many else rule, *varied.values()), strict=True)
    )


def state_arrays(chain: ClosedChain, state: State) -> dict[str, Array]:
    """Return the arrays of a state with the names used in rollouts."""
    return {name: getattr(state, field) for name, field in state_fields(chain).items()}


def plain(state: State) -> State:
    """Return a state with the plain values of its numbers, without derivatives."""
    return State(**{name: bare(x) for name, x in parts_of(state).items()})


class LinearStep(NamedTuple):
    """The linearisation of a step.

    Attributes:
        linear: the linearised code of the step, with poses at its end as wxyz_xyz.
        by: names of the varied arguments.
        found: results of the step, by name.
        poses: names of results that are poses, as wxyz_xyz.
    """

    linear: Linear
    by: tuple[str, ...]
    found: dict[str, Array]
    poses: tuple[str, ...] = STATE_POSES

    def rates(self, tangents: Mapping[str, Array]) -> dict[str, Array]:
        """Return the rates of the step's results for the given tangents; rates of poses are [turn; shift]."""
        given = [tangents.get(name, np.zeros(shape)) for name, shape in zip(self.by, self.linear.shapes, strict=True)]
        found = dict(zip(self.found, self.linear.rates(*given), strict=True))
        return found | {name: motion_of(self.found[name], found[name]) for name in self.poses if name in found}

    def gradient(self, cotangents: Mapping[str, Array]) -> dict[str, Array]:
        """Return the gradient of sum(cotangent . result); cotangents and gradients of poses refer to [turn; shift]."""
        given = {name: cotangents.get(name, np.zeros(x.shape)) for name, x in self.found.items()}
        given |= {name: by_pose(self.found[name], cotangents[name]) for name in self.poses if name in cotangents}
        return dict(zip(self.by, self.linear.gradient(*given.values()), strict=True))


class VariedStep(NamedTuple):
    """A step of one chain with one control law, to be linearised.

    Attributes:
        model: the chain with its law and its surroundings.
        tableau: the scheme.
        environment: the chain with its parameters and inputs, if they are not traced.
        many: on floats, whether the linearisation will be used for many products.
        kind: the class of the system, `VariedSystem` or what has its methods.
    """

    model: StepModel
    tableau: Tableau
    environment: Environment | None = None
    many: bool = False
    kind: Any = VariedSystem

    def linear(self, given: Given, by: Sequence[str], of: Sequence[str] = ()) -> LinearStep:
        """Return the linearisation of a step, whose code runs once.

        Args:
            given: arguments of the step, as for `TracedSystem`; "last.before" is the law's memory at the start.
            by: names of the varied arguments: arrays of the state, "before", "step", "control.*", and arguments of
                forward dynamics.
            of: names of the required results: results of forward dynamics, "tau", "memory" and "margin" at the end, and
                "work" done during the step.
        """
        return self._linear(given, by, lambda system: self._step(system, of))

    def closing(self, given: Given, by: Sequence[str]) -> LinearStep:
        """Return the linearisation of the projection onto the grasps at the start of a rollout."""
        return self._linear(given, by, lambda s: s.end_arrays(s.closed(s.time(0.0), s.state)))

    def _step(self, system: Any, of: Sequence[str]) -> dict[str, Array]:
        """Return the state after a step, the law's memory during it, and the results at its end."""
        memory, end, work = system.through(self.tableau, WORK_RESULT in of)
        found = system.end_arrays(end) | {"before": memory}
        found |= {WORK_RESULT: work} if WORK_RESULT in of else {}
        of = [name for name in of if name != WORK_RESULT]
        if not of:
            return found
        at_end = system.evaluate(system.time(1.0), end, memory, choose=False)
        own = {"tau": at_end.drive, "memory": at_end.memory}
        own |= {MARGIN_RESULT: system.margins(at_end)} if MARGIN_RESULT in of else {}
        return found | {name: own[name] if name in own else system.result(name, at_end) for name in of}

    def _linear(self, given: Given, by: Sequence[str], function: Callable[[Any], dict[str, Array]]) -> LinearStep:
        taker, shapes, found = loops.get(), self.kind.shapes(self.model.structure.chain), dict[str, Array]()
        of_state = ("qd", "object_twist", "floating_twist", "before")
        of_state += () if self.kind.positions_are_turned else ("q",)
        own = {name: f"last.{name}" for name in of_state} | {"step": "step"}
        own |= {name: name for name in by if name.startswith(LAW_PREFIX)}
        at = [given[own[name]] if name in own else np.zeros(shapes[name]) for name in by]

        def outputs(*x: Array) -> list[Array]:
            found.update(function(self.kind(self, given, dict(zip(by, x, strict=True)), taker)))
            return list(found.values())

        with loops_by(None):
            made = linearised(outputs, *at)
        poses = () if self.kind.positions_are_turned else STATE_POSES
        return LinearStep(made, tuple(by), {name: bare(x) for name, x in found.items()}, poses)
