"""Sound calls of what is asked of a chain in a state: dynamics, forces, derivatives."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import numpy as np

import holdfast as hf
from holdfast import dynamics, forces
from holdfast.questions.arrays import ARRAYS
from holdfast.questions.question import QUESTIONS
from tests.fuzz.calls import PROBLEMS, Later, call, inputs_of, numbers_of, state_of
from tests.questions.every import FUNCTIONS
from tests.systems.as_chain import Problem
from tests.systems.branched import two_arms_with_grippers


def of_chain(ask: Callable[..., Any], /, among: tuple[str, ...] = tuple(PROBLEMS), name: str = "", **more: Any) -> None:
    """Add a call for each problem: ask(chain, state, **more), states and inputs as numbers.

    What is a function in `more` makes the argument for a problem.
    """
    for which, problem in ((one, PROBLEMS[one]) for one in among):
        given = {key: Later(lambda x=x, problem=problem: x(problem())) if callable(x) else x for key, x in more.items()}
        given["chain"] = Later(lambda problem=problem: problem().chain)
        given["state"] = Later(lambda problem=problem: numbers_of(problem().state))

        def make(chain: Any, state: Any, **others: Any) -> Any:
            if "inputs" in others:
                others["inputs"] = inputs_of(others["inputs"])
            return ask(chain, state_of(state), **others)

        call(f"{name or ask.__name__} ({which})", **given)(make)


def _tau(p: Problem) -> np.ndarray:
    return np.array(p.tau)


def _inputs(p: Problem) -> dict[str, Any]:
    return numbers_of(p.inputs)


def _qdd(p: Problem) -> np.ndarray:
    return np.array(p.solved().qdd)


def _wrench(p: Problem) -> np.ndarray:
    return np.array(p.solved().grasp_wrench)


def _base(p: Problem) -> np.ndarray | None:
    return np.array(p.solved().base_acceleration) if p.chain.floats else None


def _limited(chain: Any, state: Any, **limits: Any) -> Any:
    return forces.distribute(chain, state, task=np.zeros((0, 6)), limits=forces.ForceLimits(**limits))


def _weighed(chain: Any, state: Any, **cost: Any) -> Any:
    return forces.distribute(chain, state, task=np.zeros((0, 6)), cost=forces.ForceCost(**cost))


def _smooth(chain: Any, state: Any, barrier: Any = 1e-5, **more: Any) -> Any:
    return forces.distribute.vjp(chain, state, cost=forces.ForceCost(barrier=barrier), **more)


def _project(*given: Any, **more: Any) -> Any:
    return hf.project(*given, **more)[0]


def _after_release(chain: Any, state: Any, arm: Any = "arm1", **more: Any) -> Any:
    return dynamics.momentum(dynamics.release(chain, arm), state, **more)


SOLVED: dict[str, Any] = {"result": lambda p: p.solved()}
GIVEN = {"tau": _tau, "qdd": _qdd, "grasp_wrench": _wrench, "inputs": _inputs, "base_acceleration": _base, **SOLVED}
PUSH, FIXED = np.ones(6), ("fixed",)
FREE = ["q", "qd", "tau", "object_pose", "object_twist", "gravity", "object_mass", "grasp_pose"]

of_chain(hf.forward_dynamics, tau=_tau, inputs=_inputs, check=False)
of_chain(hf.forward_dynamics, name="forward_dynamics checked", tau=_tau, inputs=_inputs, method="sequential")
of_chain(hf.diagnose)
of_chain(hf.close, hold_object=False)
of_chain(_project, name="project", inputs=_inputs)
of_chain(dynamics.project_velocity, inputs=_inputs, hold_object=False, hold_base=False)
of_chain(dynamics.contact_attitudes, parameters="quaternion")
of_chain(dynamics.centre_of_mass)
of_chain(dynamics.momentum, about=np.zeros(3), inputs=_inputs)
of_chain(dynamics.momentum_rate, **SOLVED, inputs=_inputs)
of_chain(dynamics.power, tau=_tau, **SOLVED, inputs=_inputs)
of_chain(dynamics.motion_basis)
of_chain(dynamics.object_inertia)
of_chain(dynamics.object_mobility)
of_chain(hf.assembly.assembly_report)
of_chain(hf.holding_torques, FIXED, acceleration=np.zeros(6), internal_force=3.0)
of_chain(hf.holding_torques, FIXED, "holding_torques idle", passive=lambda p: [p.chain.joint_names()[0]])
of_chain(hf.regressor, qdd=_qdd, object_acceleration=PUSH, inputs=_inputs, base_acceleration=_base)
of_chain(hf.linearise, FIXED, tau=_tau, inputs=_inputs, check=False)
of_chain(hf.linearise, FIXED, "linearise a step", tau=_tau, inputs=_inputs, step=1e-3, scheme="rk4")
of_chain(forces.split, grasp_wrench=_wrench, length=0.5)
of_chain(forces.largest_margin, **SOLVED, inputs=_inputs)
of_chain(forces.margin_range, **SOLVED)
SOME: dict[str, Any] = {"task": np.eye(6)[3:], "acceleration": np.ones(3), "inputs": _inputs}
of_chain(forces.distribute, **SOME)
of_chain(_limited, name="distribute within limits", effort=0.9, least_margin=0.0, braking=5.0)
of_chain(_weighed, name="distribute at a cost", wrench=0.1, acceleration=1.0, price=1e3)
of_chain(_smooth, FIXED, name="distribute.vjp", acceleration=np.zeros(6), tau=_tau, by=["q", "price"], barrier=1e-5)
of_chain(forces.least_peak, **SOME)
of_chain(forces.lift_margin, FIXED, acceleration=np.zeros(6), payload=True)
of_chain(forces.last_joint_wrenches, **SOLVED)
of_chain(_after_release, name="momentum of a release", arm="arm1")

of_chain(hf.forward_dynamics_vjp, tau=_tau, qdd=_qdd, grasp_wrench=_wrench, by=FREE, inputs=_inputs, check=False)
ALONG: dict[str, Any] = {"along": lambda p: {"q": _qdd(p), "object_pose": PUSH, "gravity": np.ones(3)}}
of_chain(hf.forward_dynamics_jvp, tau=_tau, **ALONG, check=False)


def _branched(state: Any, tau: Any, check: Any = True) -> Any:
    return hf.forward_dynamics(two_arms_with_grippers().chain, state_of(state), tau, check=check)


call(
    "forward_dynamics with branches",
    state=Later(lambda: numbers_of(two_arms_with_grippers().state)),
    tau=Later(lambda: np.array(two_arms_with_grippers().tau)),
    check=False,
)(_branched)


def of_question(name: str) -> None:
    """Add calls of the function that answers a question, and of its derivatives."""
    function, question = FUNCTIONS[name], QUESTIONS[name]
    given = {x: GIVEN[x] for x in inspect.signature(function).parameters if x in GIVEN}
    first, by = question.names[0], list(dict.fromkeys((question.by[0], question.by[-1])))
    of_chain(function, name=name, **given)
    cotangent = {first: lambda p: np.ones(question.shape(p.chain, first))[()]}
    of_chain(function.vjp, name=f"{name}.vjp", **given, by=by, **cotangent)
    along = {"along": lambda p: {x: np.ones(ARRAYS[x].gradient_shape(p.chain)) for x in by}}
    of_chain(function.jvp, name=f"{name}.jvp", **given, **along)
    of_chain(function.jacobian, name=f"{name}.jacobian", **given, of=[first], by=by)


for _name in FUNCTIONS:
    of_question(_name)
