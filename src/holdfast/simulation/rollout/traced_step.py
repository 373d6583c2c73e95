"""The traced time step of a system, with the functions of the reference, and the decision whether it is accepted.

At each stage of the scheme: state -> control -> forward dynamics -> slope. At the end of the step: projection ->
control -> forward dynamics -> slope (the first of the next step) -> margins -> status code.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import reduce
from typing import Any, NamedTuple

import numpy as np

from holdfast.compiled.forward_schedule import SolutionWithStatus, solve_with_status
from holdfast.compiled.structure import Structure
from holdfast.compiled.traced_chain import Given, framed, traced_chain, traced_inputs
from holdfast.compiler.schedule import FIRST_BAD
from holdfast.control.controller import ControlLaw
from holdfast.control.sampled import within_steps
from holdfast.control.traced_law import law_outputs
from holdfast.dynamics.closed.chain_solution import ChainSolution
from holdfast.dynamics.closed.tip_response import Route
from holdfast.dynamics.energy import power_of
from holdfast.dynamics.projection import LEFT_OPEN, WIDEST_GAP, Gap, StepEnd, after_step
from holdfast.forces.margins import JointLimits, margins_of_grasps, margins_of_joints
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import CONTACTS, state_fields
from holdfast.simulation.adaptive import allowed_error, error_ratio
from holdfast.simulation.balance import work_rates
from holdfast.simulation.contact_stepper import TOUCH_WRENCH
from holdfast.simulation.environment import Environment, GivenInputs
from holdfast.simulation.increment import accelerations_of, increment_rate, no_turns, velocities_of
from holdfast.simulation.instant import WORST_CONDITION
from holdfast.simulation.joint_friction import friction_torque, joint_friction
from holdfast.simulation.linearly_implicit import Implicit, passive_terms, with_armature
from holdfast.simulation.resolution import asked, largest_of, leap
from holdfast.simulation.rollout.singular_steps import passes_singular
from holdfast.simulation.rollout.user_functions import Motions, checked_motion, with_wrenches
from holdfast.simulation.runge_kutta import Tableau
from holdfast.simulation.step import EndRequest, EvaluationRequest, StageRequest, StepResult, run_step, take_step
from holdfast.spatial.scalar import Array, Scalar, array, concatenate, maximum, minimum, select, where
from holdfast.state import Inputs, State

# Status codes of the machine code. The machine code itself does not return TOO_LONG, which is determined afterwards.
# UNRESOLVED: the step may not follow the motion; the system waits until this has been judged, and goes on.
# UNLAWFUL: impulses of contacts violate their laws; the step is taken again in other ways.
RUNNING, SLIPPED, PASSES_SINGULAR, GRASP_OPEN, BROKEN, TOO_LONG, LIMITED, UNRESOLVED, UNLAWFUL = range(9)

OF_SOLUTION = ("qdd", "object_acceleration", "grasp_wrench", "base_wrench", "contact_acceleration")
STEP_RESULTS = ("slope", *OF_SOLUTION, "drive", "memory", "rank", "condition", "margin")
OF_TOUCH = ("touch_force", "touch_gap", "touch_mode", TOUCH_WRENCH)  # of the step that ends there
OF_TRUNK_RESULTS = {"floating_acceleration": "base_acceleration", "trunk_base_wrench": "trunk_base_wrench"}


def step_results(chain: ClosedChain) -> tuple[str, ...]:
    """Return the names of the arrays that are known at the end of a step."""
    of_trunk = [] if chain.trunk is None else ["trunk_base_wrench"]
    of_trunk += ["floating_acceleration"] if chain.floats else []
    of_touch = () if chain.touching is None else OF_TOUCH
    return *state_fields(chain), *STEP_RESULTS, *of_trunk, *of_touch


class Evaluation(NamedTuple):
    """The evaluation of a system at one state.

    Attributes:
        state: positions and velocities.
        found: result of forward dynamics.
        drive: (n,) torques of the law.
        memory: memory that the law has returned.
        power: (4,) in the order of `balance.WORK_TERMS` [W].
    """

    state: State
    found: SolutionWithStatus
    drive: Array
    memory: Array
    power: Array

    def slope(self, turns: list[Array]) -> Array:
        """Return the time derivative of an `increment`, for rotation vectors `turns` since the step's start."""
        return increment_rate(self.state, self.found.whole, self.power, turns)


class StepModel(NamedTuple):
    """The chain whose steps are traced, with its law and its surroundings.

    Attributes:
        structure: the structure of the chain.
        law: the control law.
        motions: motions of the moving bases.
        acting: wrenches that are part of the machine code, in addition to those of a call.
    """

    structure: Structure
    law: ControlLaw
    motions: Motions
    acting: GivenInputs | None


class TracedSystem:
    """One system during the tracing of a step.

    Attributes:
        real: the chain of the caller.
        given: the arrays of the caller.
        environment: the chain with the given parameters, and the inputs of the call.
        acting: additional wrenches that are part of the machine code.
        law: the control law.
        worst: (2,) the worst condition and status of all evaluations so far.
        conditions: the conditions of all evaluations so far.
        touches: carried arrays of contacts with the world at the step's end, by name.
        unlawful: 1 if impulses of these contacts violate their laws, else 0.
        end: the step's end, once it has been projected.
    """

    def __init__(self, model: StepModel, given: Given, environment: Environment | None = None) -> None:
        structure, self.law, motions, self.acting = model
        self.real, self.given = structure.chain, given
        if environment is None:
            chain = traced_chain(structure, given)
            moving = {name: checked_motion(name, motion) for name, motion in motions.items()}
            environment = Environment(chain, moving, traced_inputs(chain, given))
        self.environment = environment
        self.route: Route = structure.options.route
        self.friction = joint_friction(structure.chain)
        self.worst = np.zeros(2)
        self.conditions: list[Scalar] = []
        self.touches: dict[str, Array] = {}
        self.unlawful: Scalar = 0.0
        self.end: StepEnd | None = None

    @property
    def state(self) -> State:
        """The state at the start of the step."""
        return State(**{field: self.last(name) for name, field in state_fields(self.real).items()})

    @property
    def held(self) -> Array | None:
        """The constraint rows that the step satisfies, if they were chosen; see `held_rows`."""
        return self.given.get("last.held_rows")

    @property
    def added(self) -> Implicit | None:
        """The additional armatures and torques given by the caller, for stagewise steps."""
        armature = self.given.get("added_armature")
        return None if armature is None else Implicit(armature, self.given["added_torque"])

    def last(self, name: str) -> Array:
        """Return the named array at the end of the previous step; empty if there is none."""
        found = self.given.get(f"last.{name}")
        return np.zeros(0) if found is None else found

    def time(self, steps: float) -> Scalar:
        """Return the time at the given fraction of this step [s]."""
        return self.given["begin"][()] + (self.last("count")[()] + steps) * self.given["step"][()]

    def evaluate(
        self,
        t: Scalar,
        state: State,
        memory: Array,
        choose: bool,
        implicit: Implicit | None = None,
        law: ControlLaw | None = None,
    ) -> Evaluation:
        """Return the torques, and the forward dynamics and power with these torques.

        Args:
            t: time [s].
            state: positions and velocities.
            memory: memory to pass to the law.
            choose: choose the constraint rows at this state, instead of using those of the step's start.
            implicit: additional armatures and torques in a stage of a linearly implicit step.
            law: the control law, if it is not that of the system.
        """
        held = self.held
        if choose and held is not None:
            held = select(self.given["keep_rows"][()] > 0.5, held, np.ones(held.shape))
        drive, kept = self.torques(law or self.law, t, state, memory)
        lost = friction_torque(self.friction, state.qd)
        chain, inputs = self.surroundings(t, state)
        net, solved, implicit = drive - lost, chain, self.plain(implicit)
        if implicit is not None:
            net, solved = net + implicit.torque, with_armature(chain, implicit.armature)
        choose = choose and held is not None
        found = self.solve(solved, state, net, inputs, held, choose)
        power = self.power(chain, state, drive, lost, inputs, found.whole)
        self.worst = maximum(self.worst, array([found.condition, found.status]))
        self.conditions.append(found.condition)
        return Evaluation(state, found, drive, kept, power)

    def torques(self, law: ControlLaw, t: Scalar, state: State, memory: Array) -> tuple[Array, Array]:
        """Return the torques (n,) of a law, and its memory."""
        return law_outputs(law, self.real, t, state, memory, self.given)

    def at_stage(self, request: StageRequest, state: State, memory: Array) -> Array:
        """Return the slope at a stage; a sampled law holds its torques there."""
        found = self.evaluate(request.t, state, memory, False, request.implicit, within_steps(self.law))
        return found.slope(request.turns)

    def plain(self, implicit: Implicit | None) -> Implicit | None:
        """Return the additional armatures and torques of a stage as `solve` takes them."""
        return implicit

    def surroundings(self, t: Scalar, state: State) -> tuple[ClosedChain, Inputs]:
        """Return the chain with its bases at their poses at a time [s], and all inputs at that time and state."""
        chain, inputs = self.environment.at(t, state)
        if self.acting is not None:
            inputs = with_wrenches(inputs, self.acting, chain, t, state)
        return chain, inputs

    def solve(
        self, chain: ClosedChain, state: State, tau: Array, inputs: Inputs, held: Array | None, choose: bool
    ) -> SolutionWithStatus:
        """Return forward dynamics; see `solve_with_status`."""
        rank, end = self.given["generic_rank"], self.end
        there = None if end is None or end.state is not state else end.motion
        return solve_with_status(chain, framed(state), tau, inputs, rank, self.route, held, choose, there=there)

    def power(
        self, chain: ClosedChain, state: State, drive: Array, lost: Array, inputs: Inputs, whole: ChainSolution
    ) -> Array:
        """Return the power (4,) in the order of `balance.WORK_TERMS` [W]."""
        powers = power_of(chain, state, drive, whole.base_wrench, inputs, whole.trunk_base_wrench)
        return work_rates(powers, lost, state.qd)

    def step_from(self, tableau: Tableau, first: Array) -> StepResult:
        """Return the result of a step that begins with the slope `first`."""
        times = [self.time(c) for c in (*tableau.c.tolist(), 1.0)]
        passive = passive_terms(self.real) if tableau.implicit else None
        h = self.given["step"][()]
        return run_step(take_step(self.state, first, h, times, tableau, passive), self.handle)

    def results(self, now: Any) -> dict[str, Array]:
        """Return what is known at a step's end, by the names of `step_results`, and held rows."""
        end, found = now.state, now.found
        whole = found.whole
        kept = {name: getattr(end, field) for name, field in state_fields(self.real).items()}
        kept |= {name: x for name, field in OF_TRUNK_RESULTS.items() if (x := getattr(whole, field)) is not None}
        kept |= {"slope": now.slope(no_turns(end))} | {name: getattr(whole, name) for name in OF_SOLUTION}
        kept |= {"drive": now.drive, "memory": now.memory}
        kept |= {"rank": array(found.rank), "condition": array(found.condition)}
        R, contacts = end.object_frame.R, self.given[CONTACTS]
        kept["margin"] = margins_of_grasps(self.real, contacts, R, self.given["grasp_R"], whole.grasp_wrench)
        return kept | ({} if found.held is None else {"held_rows": found.held}) | self.touches

    def passes_singular(self, tableau: Tableau, end: State, drift: Gap) -> Scalar:
        """Return 1 if the step probably passes a singular configuration; see `singular_steps`."""
        return passes_singular(self, tableau, end, drift)

    def velocities(self, state: State) -> Array:
        """Return the velocities of joints and free bodies."""
        return velocities_of(state)

    def accelerations(self, state: State, slope: Array) -> Array:
        """Return their time derivatives in the rate of an increment."""
        return accelerations_of(state, slope)

    def coordinates(self, q: Array) -> Array:
        """Return the positions of the joints in the order of their rates, (n,)."""
        return q

    def handle(self, request: EvaluationRequest) -> Any:
        """Return the reply to a request of a step; if the input `held` is set, states are not projected."""
        still = self.given["held"][()] > 0.5
        t, at = request.t, request.state
        if isinstance(request, EndRequest):
            return self.evaluate(t, at, self.last("memory"), True, self.added)
        fields = state_fields(self.real)
        poses = {field: name for name, field in fields.items() if name.endswith("pose")}
        # a rotation by zero could change the last bit
        kept = {field: select(still, self.last(name), getattr(at, field)) for field, name in poses.items()}
        at = replace(at, **kept)
        if isinstance(request, StageRequest):
            return self.at_stage(request, at, self.last("memory"))
        chain, inputs = self.environment.at(t, at)

        def going_on(before: State, after: State) -> State:
            return State(
                **{name: select(still, getattr(before, name), getattr(after, name)) for name in fields.values()}
            )

        self.end = after_step(chain, at, inputs, self.held, going_on)
        return self.end.state, [self.end.before, self.end.after]


def step(model: StepModel, tableau: Tableau, given: Given) -> dict[str, Any]:
    """Return the carried arrays of a system after `take_step`; a system that stops keeps its last state."""
    return step_of(TracedSystem(model, given), tableau)


def step_of(system: TracedSystem, tableau: Tableau) -> dict[str, Any]:
    """Return the same of a traced system."""
    given = system.given
    now, (drift, gaps), work, estimates = system.step_from(tableau, system.last("slope"))
    end, kept = now.state, system.results(now)
    passed = system.passes_singular(tableau, end, drift) * given["search"][()]
    code = stop_code(system, kept, drift, gaps, passed)
    code, known = resolution(system, end, kept, code) if "last.resolution" in given else (code, {})
    if "tolerance" in given:
        rtol, atol = given["tolerance"]
        known = {**known, "last.error": array(error_ratio(estimates, allowed_error(rtol, atol, system.state, end)))}
    return {**carried(system, kept, code, work, system.time(1.0), concatenate([drift, gaps])), **known}


def stop_code(system: TracedSystem, kept: Mapping[str, Array], drift: Gap, gaps: Gap, passed: Scalar) -> Scalar:
    """Return the status code of a system after the step.

    Args:
        system: the system.
        kept: arrays at the step's end, by name.
        drift: gaps before projection.
        gaps: gaps after projection.
        passed: whether the step passes a singular configuration, 1 or 0.
    """
    given, margins = system.given, list(kept["margin"])
    # x - x would detect the same, but it is folded to zero
    total = sum(sum(abs(entry) for entry in x.flat) for name, x in kept.items() if name != "margin")
    least = reduce(minimum, margins) if margins else float("inf")
    q = system.coordinates(kept["q"])
    of_joints = margins_of_joints(JointLimits(*given["limits"]), q, kept["qd"], kept["drive"])
    beyond = reduce(minimum, concatenate(of_joints), float("inf")) < given["least_joint_margin"][()]
    fault = where(beyond, float(LIMITED), float(RUNNING))
    fault = where(least < given["least_margin"][()], float(SLIPPED), fault)
    fault = where(system.worst[0] <= WORST_CONDITION, fault, float(PASSES_SINGULAR))
    fault = where(system.worst[1] < FIRST_BAD, fault, float(PASSES_SINGULAR))
    fault = where(passed < 0.5, fault, float(PASSES_SINGULAR))
    fault = where(drift.position <= WIDEST_GAP, fault, float(GRASP_OPEN))
    left = where(given["held"][()] > 0.5, 0.0, gaps.position)  # without projection the gaps do not matter
    fault = where(left <= LEFT_OPEN, fault, float(GRASP_OPEN))
    fault = where(total < float("inf"), fault, float(BROKEN))
    for margin in margins:  # infinite where nothing limits, not-a-number where squares of forces overflow
        fault = where(margin <= float("inf"), fault, float(BROKEN))
    if system.touches:
        fault = where(system.unlawful < 0.5, fault, float(UNLAWFUL))
    code = system.last("code")[()]
    return where(code > 0.5, code, fault)


def resolution(system: TracedSystem, end: State, kept: Mapping[str, Array], code: Scalar) -> tuple[Scalar, Given]:
    """Return the status code after the step, and what is known of its resolution; see `simulation.resolution`.

    Args:
        system: the system.
        end: the state at the step's end.
        kept: arrays at the step's end, by name.
        code: status code without regard to this.
    """
    v0, v1 = system.velocities(system.state), system.velocities(end)
    a0, a1 = (system.accelerations(end, slope) for slope in (system.last("slope"), kept["slope"]))
    gap = system.given["notice"][()] * leap(system.given["step"][()], v0, v1, a0, a1)
    if within_steps(system.law) is not system.law:  # a sample at the step's end changes the torques after it
        gap = where(largest_of(kept["drive"] - system.last("drive")) > 0.0, 0.0, gap)
    waits, found = asked(system.last("resolution"), largest_of(v1), gap, code < 0.5)
    return where(waits, float(UNRESOLVED), code), {"last.resolution": found}


def carried(
    system: TracedSystem, kept: Mapping[str, Array], code: Scalar, work: Array, t: Scalar, gaps: Array
) -> dict[str, Array]:
    """Return the carried arrays: those at the step's end if the system is running, otherwise the previous ones.

    Args:
        system: the system.
        kept: arrays at the step's end, by name.
        code: status code of the system.
        work: (4,) work done during the step [J].
        t: the step's end [s].
        gaps: (4,) position and velocity gaps before projection, and after it.
    """
    on, last = code < 0.5, system.last
    found = {name: select(on, x, last(name)) for name, x in kept.items()}
    found["work"] = select(on, last("work") + work, last("work"))
    found["gaps"] = select(on, gaps, last("gaps"))
    found["code"], found["count"] = array(code), array(last("count")[()] + where(on, 1.0, 0.0))
    found["before"] = select(on, last("memory"), last("before"))
    worst, since = last("worst_margin"), last("worst_time")
    lower = [where(on, m, float("inf")) < w for m, w in zip(kept["margin"], worst, strict=True)]
    found["worst_margin"] = array([where(l, m, w) for l, m, w in zip(lower, kept["margin"], worst, strict=True)])
    found["worst_time"] = array([where(l, t, s) for l, s in zip(lower, since, strict=True)])
    return {f"last.{name}": x for name, x in found.items()}


def evaluation(model: StepModel, given: Given) -> dict[str, Array]:
    """Return the slope at the current state with new inputs; the law is evaluated again with its previous memory."""
    return evaluation_of(TracedSystem(model, given))


def evaluation_of(system: TracedSystem) -> dict[str, Array]:
    """Return the same of a traced system."""
    now = system.evaluate(system.time(0.0), system.state, system.last("before"), choose=False)
    on = system.last("code")[()] < 0.5
    return {
        "last.slope": select(on, now.slope(no_turns(now.state)), system.last("slope")),
        "last.memory": select(on, now.memory, system.last("memory")),
    }
