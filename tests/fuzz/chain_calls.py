"""Sound calls of what is asked of a chain in a state: dynamics, forces, derivatives."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import holdfast as hf
from holdfast import dynamics, forces
from tests.fuzz.calls import PROBLEMS, Later, call, inputs_of, numbers_of, state_of
from tests.systems.as_chain import Problem


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


def _of_q(p: Problem) -> dict[str, Any]:
    return {"q": _qdd(p)}


def _project(*given: Any, **more: Any) -> Any:
    return hf.project(*given, **more)[0]


def _after_release(chain: Any, state: Any, arm: Any) -> Any:
    return dynamics.momentum(dynamics.release(chain, arm), state)


SOLVED: dict[str, Any] = {"result": lambda p: p.solved()}
PUSH, FIXED = np.ones(6), ("fixed",)
NEEDED = {"qdd": _qdd, "grasp_wrench": _wrench, "inputs": _inputs, "base_acceleration": _base}  # by inverse dynamics
FREE = ["q", "qd", "tau", "object_pose", "object_twist", "gravity", "object_mass", "grasp_pose"]

of_chain(hf.forward_dynamics, tau=_tau, inputs=_inputs, check=False)
of_chain(hf.forward_dynamics, name="forward_dynamics checked", tau=_tau, inputs=_inputs, method="sequential")
of_chain(hf.diagnose)
of_chain(hf.close, hold_object=False)
of_chain(_project, name="project", inputs=_inputs)
of_chain(dynamics.project_velocity, inputs=_inputs, hold_object=False, hold_base=False)
of_chain(dynamics.closure, inputs=_inputs)
of_chain(dynamics.contact_attitudes, parameters="quaternion")
of_chain(dynamics.kinetic_energy, inputs=_inputs)
of_chain(dynamics.potential_energy)
of_chain(dynamics.centre_of_mass)
of_chain(dynamics.momentum, about=np.zeros(3), inputs=_inputs)
of_chain(dynamics.momentum_rate, **SOLVED, inputs=_inputs)
of_chain(dynamics.power, tau=_tau, **SOLVED, inputs=_inputs)
of_chain(dynamics.motion_basis)
of_chain(dynamics.object_inertia)
of_chain(dynamics.object_mobility)
of_chain(hf.assembly.assembly_report)
of_chain(hf.holding_torques, FIXED, acceleration=np.zeros(6), internal=3.0)
of_chain(hf.holding_torques, FIXED, "holding_torques idle", undriven=lambda p: [p.chain.joint_names()[0]])
of_chain(hf.inverse_dynamics, **NEEDED)
of_chain(hf.regressor, qdd=_qdd, object_acceleration=PUSH, inputs=_inputs, base_acceleration=_base)
of_chain(hf.linearise, FIXED, tau=_tau, inputs=_inputs, check=False)
of_chain(hf.linearise, FIXED, "linearise a step", tau=_tau, inputs=_inputs, step=1e-3, scheme="rk4")
of_chain(forces.grasp_margins, grasp_wrench=_wrench)
of_chain(forces.joint_margins, tau=_tau)
of_chain(forces.split, grasp_wrench=_wrench, length=0.5)
of_chain(forces.largest_margin, **SOLVED, inputs=_inputs)
of_chain(forces.margin_range, **SOLVED)
of_chain(forces.wrist_wrenches, **SOLVED)
of_chain(forces.last_joint_wrenches, **SOLVED)
of_chain(_after_release, name="momentum of a release", arm="arm1")

of_chain(hf.forward_dynamics_vjp, tau=_tau, qdd=_qdd, grasp_wrench=_wrench, by=FREE, inputs=_inputs, check=False)
ALONG: dict[str, Any] = {"along": lambda p: {"q": _qdd(p), "object_pose": PUSH, "gravity": np.ones(3)}}
of_chain(hf.forward_dynamics_jvp, tau=_tau, **ALONG, check=False)
of_chain(hf.inverse_dynamics.vjp, **NEEDED, tau=_tau, by=["q", "qd"])
of_chain(hf.inverse_dynamics.jvp, **NEEDED, along=_of_q)
of_chain(hf.inverse_dynamics.jacobian, **NEEDED, of=["tau"], by=["q", "grasp_wrench"])
of_chain(
    dynamics.closure.vjp,
    by=["q", "object_pose"],
    position=lambda p: np.ones(len(dynamics.closure.jacobian(p.chain, p.state, of=["position"])["position", "q"])),
)
of_chain(dynamics.closure.jvp, along=lambda p: {"q": _qdd(p), "object_twist": PUSH})
of_chain(dynamics.closure.jacobian, of=["position", "velocity"], by=["q", "qd"])
of_chain(dynamics.kinetic_energy.vjp, by=["q", "qd"], kinetic_energy=1.0)
of_chain(dynamics.kinetic_energy.jvp, along=_of_q)
of_chain(dynamics.kinetic_energy.jacobian, of=["kinetic_energy"], by=["q"])
of_chain(dynamics.potential_energy.vjp, by=["q"], potential_energy=1.0)
of_chain(dynamics.potential_energy.jvp, along=lambda p: {"q": _qdd(p), "gravity": np.ones(3)})
of_chain(dynamics.potential_energy.jacobian, of=["potential_energy"], by=["q"])
of_chain(
    forces.grasp_margins.vjp,
    grasp_wrench=_wrench,
    by=["grasp_wrench"],
    grasp_margins=lambda p: np.ones(len(p.chain.arms)),
)
of_chain(forces.grasp_margins.jvp, grasp_wrench=_wrench, along={"object_pose": PUSH})
of_chain(forces.grasp_margins.jacobian, grasp_wrench=_wrench, of=["grasp_margins"], by=["grasp_wrench"])
of_chain(forces.joint_margins.vjp, tau=_tau, by=["q", "tau"], effort=_qdd)
of_chain(forces.joint_margins.jvp, tau=_tau, along=lambda p: {"tau": _qdd(p)})
of_chain(forces.joint_margins.jacobian, tau=_tau, of=["effort"], by=["tau"])
of_chain(forces.wrist_wrenches.vjp, **SOLVED, by=["q"], wrist_wrenches=_wrench)
of_chain(forces.wrist_wrenches.jvp, **SOLVED, along=_of_q)
of_chain(forces.wrist_wrenches.jacobian, **SOLVED, of=["wrist_wrenches"], by=["q"])
