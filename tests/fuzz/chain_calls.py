"""Sound calls of what is asked of a chain in a state: dynamics, forces, derivatives."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

import holdfast as hf
from holdfast import dynamics, forces
from tests.fuzz.calls import (
    PROBLEMS,
    Later,
    call,
    inputs_of,
    numbers_of,
    state_of,
)
from tests.systems.as_chain import Problem


def of_chain(
    name: str, ask: Callable[..., Any], /, among: tuple[str, ...] = tuple(PROBLEMS), **more: Callable[[Problem], Any]
) -> None:
    """Add a call for each problem: ask(chain, state, **more), states and inputs as numbers."""
    for which, problem in ((one, PROBLEMS[one]) for one in among):
        given = {key: Later(lambda make=make, problem=problem: make(problem())) for key, make in more.items()}
        given["chain"] = Later(lambda problem=problem: problem().chain)
        given["state"] = Later(lambda problem=problem: numbers_of(problem().state))

        def make(chain: Any, state: Any, **others: Any) -> Any:
            if "inputs" in others:
                others["inputs"] = inputs_of(others["inputs"])
            return ask(chain, state_of(state), **others)

        call(f"{name} ({which})", **given)(make)


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


def _result(p: Problem) -> Any:
    return p.solved()


def _no(p: Problem) -> bool:
    return False


def _push(p: Problem) -> np.ndarray:
    return np.ones(6)


def _names(*names: str) -> Callable[[Problem], list[str]]:
    return lambda p: list(names)


of_chain("forward_dynamics", hf.forward_dynamics, tau=_tau, inputs=_inputs, check=_no)
of_chain("forward_dynamics checked", hf.forward_dynamics, tau=_tau, inputs=_inputs, method=lambda p: "sequential")
of_chain("diagnose", hf.diagnose)
of_chain("close", hf.close, hold_object=_no)
of_chain("project", lambda *x, **more: hf.project(*x, **more)[0], inputs=_inputs)
of_chain("project_velocity", dynamics.project_velocity, inputs=_inputs, hold_object=_no, hold_base=_no)
of_chain("closure", dynamics.closure, inputs=_inputs)
of_chain("contact_attitudes", dynamics.contact_attitudes, parameters=lambda p: "quaternion")
of_chain("kinetic_energy", dynamics.kinetic_energy, inputs=_inputs)
of_chain("potential_energy", dynamics.potential_energy)
of_chain("centre_of_mass", dynamics.centre_of_mass)
of_chain("momentum", dynamics.momentum, about=lambda p: np.zeros(3), inputs=_inputs)
of_chain("momentum_rate", dynamics.momentum_rate, result=_result, inputs=_inputs)
of_chain("power", dynamics.power, tau=_tau, result=_result, inputs=_inputs)
of_chain("motion_basis", dynamics.motion_basis)
of_chain("object_inertia", dynamics.object_inertia)
of_chain("object_mobility", dynamics.object_mobility)
of_chain("assembly_report", hf.assembly.assembly_report)
of_chain("holding_torques", hf.holding_torques, ("fixed",), acceleration=lambda p: np.zeros(6), internal=lambda p: 3.0)
of_chain("holding_torques idle", hf.holding_torques, ("fixed",), undriven=lambda p: [p.chain.joint_names()[0]])
of_chain(
    "inverse_dynamics", hf.inverse_dynamics, qdd=_qdd, grasp_wrench=_wrench, inputs=_inputs, base_acceleration=_base
)
of_chain("regressor", hf.regressor, qdd=_qdd, object_acceleration=_push, inputs=_inputs, base_acceleration=_base)
of_chain("linearise", hf.linearise, ("fixed",), tau=_tau, inputs=_inputs, check=_no)
of_chain(
    "linearise a step", hf.linearise, ("fixed",), tau=_tau, inputs=_inputs, step=lambda p: 1e-3, scheme=lambda p: "rk4"
)
of_chain("grasp_margins", forces.grasp_margins, grasp_wrench=_wrench)
of_chain("joint_margins", forces.joint_margins, tau=_tau)
of_chain("split", forces.split, grasp_wrench=_wrench, length=lambda p: 0.5)
of_chain("largest_margin", forces.largest_margin, result=_result, inputs=_inputs)
of_chain("margin_range", forces.margin_range, result=_result)
of_chain("wrist_wrenches", forces.wrist_wrenches, result=_result)
of_chain("last_joint_wrenches", forces.last_joint_wrenches, result=_result)
of_chain(
    "momentum of a release",
    lambda chain, state, arm: dynamics.momentum(dynamics.release(chain, arm), state),
    arm=lambda p: "arm1",
)
of_chain(
    "forward_dynamics_vjp",
    hf.forward_dynamics_vjp,
    tau=_tau,
    qdd=_qdd,
    grasp_wrench=_wrench,
    by=_names("q", "qd", "tau", "object_pose", "object_twist", "gravity", "object_mass", "grasp_pose"),
    inputs=_inputs,
    check=_no,
)
of_chain(
    "forward_dynamics_jvp",
    hf.forward_dynamics_jvp,
    tau=_tau,
    along=lambda p: {"q": _qdd(p), "object_pose": np.ones(6), "gravity": np.ones(3)},
    check=_no,
)
of_chain(
    "forward_dynamics_jacobian",
    hf.forward_dynamics_jacobian,
    ("fixed",),
    tau=_tau,
    of=_names("qdd", "grasp_wrench"),
    by=_names("q", "tau"),
    check=_no,
)
of_chain(
    "inverse_dynamics_vjp",
    hf.inverse_dynamics_vjp,
    base_acceleration=_base,
    inputs=_inputs,
    qdd=_qdd,
    grasp_wrench=_wrench,
    tau=_tau,
    by=_names("q", "qd"),
)
of_chain(
    "inverse_dynamics_jvp",
    hf.inverse_dynamics_jvp,
    base_acceleration=_base,
    inputs=_inputs,
    qdd=_qdd,
    grasp_wrench=_wrench,
    along=lambda p: {"q": _qdd(p)},
)
of_chain(
    "inverse_dynamics_jacobian",
    hf.inverse_dynamics_jacobian,
    base_acceleration=_base,
    inputs=_inputs,
    qdd=_qdd,
    grasp_wrench=_wrench,
    of=_names("tau"),
    by=_names("q", "grasp_wrench"),
)
of_chain(
    "closure_vjp",
    dynamics.closure_vjp,
    by=_names("q", "object_pose"),
    position=lambda p: np.ones(len(dynamics.closure_jacobian(p.chain, p.state, of=["position"])["position", "q"])),
)
of_chain("closure_jvp", dynamics.closure_jvp, along=lambda p: {"q": _qdd(p), "object_twist": np.ones(6)})
of_chain("closure_jacobian", dynamics.closure_jacobian, of=_names("position", "velocity"), by=_names("q", "qd"))
of_chain("kinetic_energy_vjp", dynamics.kinetic_energy_vjp, by=_names("q", "qd"), kinetic_energy=lambda p: 1.0)
of_chain("kinetic_energy_jvp", dynamics.kinetic_energy_jvp, along=lambda p: {"q": _qdd(p)})
of_chain("kinetic_energy_jacobian", dynamics.kinetic_energy_jacobian, of=_names("kinetic_energy"), by=_names("q"))
of_chain("potential_energy_vjp", dynamics.potential_energy_vjp, by=_names("q"), potential_energy=lambda p: 1.0)
of_chain("potential_energy_jvp", dynamics.potential_energy_jvp, along=lambda p: {"q": _qdd(p), "gravity": np.ones(3)})
of_chain("potential_energy_jacobian", dynamics.potential_energy_jacobian, of=_names("potential_energy"), by=_names("q"))
of_chain(
    "grasp_margins_vjp",
    forces.grasp_margins_vjp,
    grasp_wrench=_wrench,
    by=_names("grasp_wrench"),
    grasp_margins=lambda p: np.ones(len(p.chain.arms)),
)
of_chain(
    "grasp_margins_jvp", forces.grasp_margins_jvp, grasp_wrench=_wrench, along=lambda p: {"object_pose": np.ones(6)}
)
of_chain(
    "grasp_margins_jacobian",
    forces.grasp_margins_jacobian,
    grasp_wrench=_wrench,
    of=_names("grasp_margins"),
    by=_names("grasp_wrench"),
)
of_chain("joint_margins_vjp", forces.joint_margins_vjp, tau=_tau, by=_names("q", "tau"), effort=_qdd)
of_chain("joint_margins_jvp", forces.joint_margins_jvp, tau=_tau, along=lambda p: {"tau": _qdd(p)})
of_chain("joint_margins_jacobian", forces.joint_margins_jacobian, tau=_tau, of=_names("effort"), by=_names("tau"))
of_chain("wrist_wrenches_vjp", forces.wrist_wrenches_vjp, result=_result, by=_names("q"), wrist_wrenches=_wrench)
of_chain("wrist_wrenches_jvp", forces.wrist_wrenches_jvp, result=_result, along=lambda p: {"q": _qdd(p)})
of_chain(
    "wrist_wrenches_jacobian",
    forces.wrist_wrenches_jacobian,
    result=_result,
    of=_names("wrist_wrenches"),
    by=_names("q"),
)
