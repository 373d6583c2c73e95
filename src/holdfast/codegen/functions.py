"""The computations of a chain that can be exported."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np

from holdfast.compiled.chain import CompiledChain
from holdfast.compiled.derivative_computation import computation_of, request_of
from holdfast.compiled.derivative_schedule import DerivativeKind
from holdfast.compiled.forest import CompiledForest, CompiledMechanism
from holdfast.compiled.forest_function import ForestFunction
from holdfast.compiled.parameters import parameters_of
from holdfast.compiled.result import INDETERMINATE, INVALID, OK, SINGULAR, UNDECIDED
from holdfast.compiler.schedule import External, Schedule
from holdfast.control.compiled_law import law_and_values, law_computation
from holdfast.control.controller import ControlLaw, Controller, held_torques
from holdfast.dynamics.rank import closed_near, constraint_rank, generic_rank_near
from holdfast.errors import MethodNotApplicable, ModelError, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import state_fields
from holdfast.questions.question import QUESTIONS
from holdfast.simulation.environment import BaseMotion, Environment
from holdfast.simulation.rollout.kernel import StepKernel
from holdfast.simulation.rollout.rollout import Rollout
from holdfast.simulation.rollout.traced_step import BROKEN, GRASP_OPEN, LIMITED, PASSES_SINGULAR, RUNNING, SLIPPED
from holdfast.simulation.runge_kutta import IMEX
from holdfast.simulation.runge_kutta import scheme as scheme_of
from holdfast.spatial.scalar import Array
from holdfast.state import State

STEP_FUNCTION = "step"

_ANSWERS = {
    "ok": (OK, "everything is unique"),
    "indeterminate": (INDETERMINATE, "the forces are one solution of many, all else is unique"),
    "undecided": (UNDECIDED, "the rank is low, and the generic rank is not known"),
    "singular": (SINGULAR, "a singular configuration: no answer, results are not-a-number"),
    "invalid": (INVALID, "invalid inputs: no answer, results are not-a-number"),
}
_STEPS = {
    "running": (RUNNING, "the step was taken"),
    "slipped": (SLIPPED, "not taken: a grasp's margin would fall below the least allowed"),
    "passes_singular": (PASSES_SINGULAR, "not taken: the configuration is singular, or becomes so"),
    "open": (GRASP_OPEN, "not taken: a grasp is open, or the step is too long"),
    "broken": (BROKEN, "not taken: the state would not be finite"),
    "limited": (LIMITED, "not taken: a joint would pass a limit"),
}
_STEP_SUMMARY = "one step of the closed chain under torques that are held: the state in place, back on the grasps"
_KINDS = {
    "vjp": "and gradients of sum(with . result)",
    "jvp": "and the rates of its results along `with`",
    "jacobian": "and its Jacobian, transposed: a row for each number that is varied",
}


_OF_FOREST: dict[str, Literal["vjp", "jvp"]] = {"_vjp": "vjp", "_jvp": "jvp"}
FOREST_FUNCTIONS = ("forward_dynamics", *(f"forward_dynamics{kind}" for kind in _OF_FOREST), "inverse_dynamics")


def exported_names() -> tuple[str, ...]:
    """Return the names of everything that can be exported: questions, derivatives of them, and a step."""
    derivatives = (f"{name}_{kind}" for name, of in QUESTIONS.items() if of.by for kind in get_args(DerivativeKind))
    return *QUESTIONS, *derivatives, STEP_FUNCTION


@dataclass(frozen=True, eq=False)
class ExportedFunction:
    """A computation that is exported as a C function.

    Attributes:
        name: name of the function, without prefix.
        summary: a sentence that says what the function computes.
        externals: the arrays that the function takes and returns.
        schedule: function that returns the schedule to compile.
        values: initial values of arrays, by name; the other arrays are initially zero.
        statuses: the function's return codes by name, each with its meaning; without statuses it returns 0.
    """

    name: str
    summary: str
    externals: Mapping[str, External]
    schedule: Callable[[], Schedule]
    values: Mapping[str, Array]
    statuses: Mapping[str, tuple[int, str]]


def exported_function(
    name: str,
    compiled: CompiledChain,
    state: State | None = None,
    of: Sequence[str] | None = None,
    by: Sequence[str] | None = None,
    scheme: str = "rk4",
    base_motion: Mapping[str, BaseMotion] | None = None,
) -> ExportedFunction:
    """Return one of the functions in `exported_names`.

    Args:
        name: name of the computation.
        compiled: the compiled chain, with its options.
        state: initial state of a step, at which the generic rank is found if it is unknown.
        of: names of the results of derivatives; by default those of the question.
        by: names of the arguments of derivatives; by default those of the question.
        scheme: scheme of a step: rk4, midpoint, or imex for stiff joints.
        base_motion: for a step, traceable functions of t that return pose, twist and acceleration of moving bases.

    Raises:
        ModelError: there is no such computation, a step has no state, or a motion belongs to no base.
    """
    if name == STEP_FUNCTION:
        return _step(compiled, state, scheme, base_motion or {})
    chain, rank = compiled.chain, generic_rank_of(compiled, state)
    own = parameters_of(chain, rank) | {"object_pose": np.eye(7)[0]} | _arrays(chain, state)
    kind: DerivativeKind | None = next((kind for kind in get_args(DerivativeKind) if name.endswith(f"_{kind}")), None)
    question = name if kind is None else name.removesuffix(f"_{kind}")
    if name not in exported_names():
        raise ModelError(f"export: functions: no '{name}'.{checks.did_you_mean(name, exported_names())}")
    asked, request = QUESTIONS[question], None
    if kind is not None:
        results = (asked.of or asked.names_at(chain)) if of is None else of
        request = request_of(asked, chain, kind, results, asked.by if by is None else by)
    made = computation_of(asked, request, chain, compiled.options)
    summary = asked.summary if kind is None else f"{asked.summary}, {_KINDS[kind]}"
    values = own | dict(made.fixed)
    return _function(name, summary, made.externals, made.schedule, values, _ANSWERS if made.has_status else {})


def exported_of_forest(
    name: str,
    compiled: CompiledMechanism | CompiledForest,
    state: State | None = None,
    of: Sequence[str] | None = None,
    by: Sequence[str] | None = None,
) -> ExportedFunction:
    """Return one of `FOREST_FUNCTIONS` of a chain that is answered as a forest, or of a forest.

    Args:
        name: the name.
        compiled: its machine code.
        state: state of the chain in memory at first; without one, joints at zero and bodies in the world's frame.
        of: names of the results of derivatives.
        by: names of the arguments of derivatives.

    Raises:
        MethodNotApplicable: it has no machine code of the function.
        StateError: a result or an argument is unknown.
    """
    if name not in FOREST_FUNCTIONS:
        raise MethodNotApplicable(
            f"export: functions: '{name}': expected {', '.join(FOREST_FUNCTIONS)} of a chain that is answered as a"
            " forest, which has no other machine code yet"
        )
    question, _, derivative = name.partition("_dynamics")
    made: ForestFunction = getattr(compiled, f"{question}_dynamics").function
    terms, summary = made.terms, QUESTIONS[f"{question}_dynamics"].summary
    if derivative:
        kind = _OF_FOREST[derivative]
        made = compiled.forward_dynamics.derived(kind, of or terms.of, by or terms.by)
        summary = f"{summary}, {_KINDS[kind]}"
    chain = terms.subject if isinstance(compiled, CompiledMechanism) else None
    values = _at_rest(made.externals) | ({} if chain is None else _arrays(chain, state))
    impossible = {"undecided"} if "rank" in made.of_status else {"undecided", "indeterminate", "singular"}
    statuses = {key: says for key, says in _ANSWERS.items() if key not in impossible}
    return _function(name, summary, made.externals, made.schedule, values, statuses)


def _at_rest(externals: Mapping[str, External]) -> dict[str, Array]:
    """Return the poses of free bodies at first, those of the world."""
    found = {}
    for name in ("object_pose", "floating_pose"):
        if name in externals:
            found[name] = np.zeros(externals[name].shape)
            found[name][..., 0] = 1.0
    return found


def exported_law(name: str, law: Controller | ControlLaw, compiled: CompiledChain) -> ExportedFunction:
    """Return a control law, which computes torques from a state; it reads `memory` and returns its new value as `kept`.

    Raises:
        MethodNotApplicable: the law cannot be traced.
    """
    chain = compiled.chain
    traced, given = law_and_values(law, chain)
    values = {"object_pose": np.eye(7)[0], "memory": traced.memory, **given}
    made = law_computation(traced, chain)
    return _function(name, "torques of a control law", made.externals, made.schedule, values)


def generic_rank_of(compiled: CompiledChain, state: State | None) -> int | None:
    """Return the generic rank if it is known or can be found from a state; otherwise None."""
    if compiled.generic_rank is not None or state is None:
        return compiled.generic_rank
    closed = closed_near(compiled.chain, state) or state
    return generic_rank_near(compiled.chain, closed, constraint_rank(compiled.chain, closed))


def _function(
    name: str,
    summary: str,
    externals: Mapping[str, External],
    schedule: Callable[[], Schedule],
    values: Mapping[str, Array],
    statuses: Mapping[str, tuple[int, str]] | None = None,
) -> ExportedFunction:
    own = {key: np.asarray(values[key]) for key, e in externals.items() if key in values and e.role != "output"}
    return ExportedFunction(name, f"{summary[0].upper()}{summary[1:]}.", externals, schedule, own, statuses or {})


def _arrays(chain: ClosedChain, state: State | None) -> dict[str, Array]:
    """Return a state as arrays with the names of the machine code; none without a state."""
    given = {name: getattr(state, field, None) for name, field in state_fields(chain).items()}
    return {name: np.asarray(x) for name, x in given.items() if x is not None}


def _step(
    compiled: CompiledChain, state: State | None, scheme: str, base_motion: Mapping[str, BaseMotion]
) -> ExportedFunction:
    """Return a step, with the arrays of a rollout that starts at the state."""
    chain, options = compiled.chain, compiled.options
    if state is None:
        raise ModelError("export: 'step' begins at a state that closes the grasps; expected state=..., got none")
    if options.base_motion:
        raise StateError(
            "export: 'step' has bases that move as functions of time; expected the chain as `holdfast.compile` returns"
            " it, and base_motion={arm: t -> (pose, twist, acceleration)}"
        )
    tableau = IMEX if scheme == IMEX.name else scheme_of(scheme)
    if tableau.adaptive:
        raise ModelError(f"export: scheme: expected 'rk4', 'midpoint' or '{IMEX.name}', got '{scheme}'")
    law, motions = held_torques(chain.joint_count), Environment(chain, base_motion).base_motion
    rollout = Rollout(chain, law, "rk4", generic_rank_of(compiled, state), motions, options)
    given: dict[str, Any] = {**_arrays(chain, state), "tau": np.zeros(chain.joint_count)}
    systems: Any = rollout.start(**given)
    if not systems.running.all():
        raise StateError(f"export: state: expected one from which steps can begin; it {systems.status[0].value}")
    kernel = StepKernel(chain, law, tableau, rollout.generic_rank or 0, motions=motions, options=options)
    values = kernel.parameters | kernel.defaults | {f"last.{name}": x[0] for name, x in systems.arrays.items()}
    values |= {"step": np.array(1e-3)}

    made = kernel.with_new_inputs(tableau)

    def schedule() -> Schedule:
        return replace(made.schedule(), status="last.code")  # returned, and not only carried to the next step

    return _function(STEP_FUNCTION, _STEP_SUMMARY, kernel.externals, schedule, values, _STEPS)
