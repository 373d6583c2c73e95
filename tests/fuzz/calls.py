"""Sound calls of what the library offers, as functions of nested arguments that a fuzz can spoil."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any

import numpy as np

import holdfast as hf
from holdfast import control, dynamics, forces
from tests.systems.anchored import pinned_to_trunk
from tests.systems.as_chain import Problem
from tests.systems.bushed import bushed
from tests.systems.problems import random_problem
from tests.systems.trunk_problems import on_trunk


@dataclass(frozen=True)
class Call:
    """A call.

    Attributes:
        make: takes the arguments by name and returns what comes of them.
        given: returns sound arguments: numbers, arrays, parts, lists and dicts of them.
    """

    make: Callable[..., Any]
    given: Callable[[], dict[str, Any]]


CALLS: dict[str, Call] = {}


def call(name: str, /, **given: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Add a function of its sound arguments to the table; a callable that has no parameters makes one."""

    def add(make: Callable[..., Any]) -> Callable[..., Any]:
        assert name not in CALLS
        CALLS[name] = Call(make, lambda: {key: x.made() if isinstance(x, Later) else x for key, x in given.items()})
        return make

    return add


@dataclass(frozen=True)
class Later:
    """An argument that is made when it is first needed."""

    made: Callable[[], Any]


def state_of(given: Any) -> Any:
    """Return the state of numbers by name; what is none stays."""
    return hf.State(**given) if named(given, hf.State) else given


def inputs_of(given: Any) -> Any:
    """Return the inputs of numbers by name; what is none stays."""
    return hf.Inputs(**given) if named(given, hf.Inputs) else given


def named(given: Any, kind: Any) -> bool:
    """Return whether something can be keyword arguments of a constructor; another call is Python's to refuse."""
    try:
        inspect.signature(kind).bind(**given)
    except TypeError:
        return False
    return isinstance(given, dict)


def numbers_of(part: Any) -> dict[str, Any]:
    """Return the fields of a state or inputs that are given."""
    return {one.name: x for one in fields(part) if (x := getattr(part, one.name)) is not None}


# The chains.


@cache
def everything() -> Problem:
    """Return two arms and an anchor on a floating trunk of one joint, a bushing, springs; everything moves."""
    options = {"moving_base": False, "extras": False}
    p = bushed(random_problem(3, joints=(3, 6), grasps=("ball", "rigid"), **options), ("arm2",))
    p = pinned_to_trunk(on_trunk(p, 3, 1, floating=True, in_world=0.0), "ball")
    springs = [
        hf.Spring(("world", [0.0, 0.0, 1.0]), ("object", [0.1, 0.0, 0.0]), 20.0, 0.1, 0.5),
        hf.Spring(("trunk", "base", [0.0, 0.2, 0.0]), ("arm1", 1, [0.0, 0.0, 0.1]), 10.0),
    ]
    return replace(p, chain=replace(p.chain, springs=springs))


@cache
def fixed() -> Problem:
    """Return two arms that hold the object by a rigid grasp and a soft finger, on bases that stand."""
    return random_problem(1, joints=(4, 6), grasps=("softfinger", "rigid"), moving_base=False, extras=False)


PROBLEMS: dict[str, Callable[[], Problem]] = {"everything": everything, "fixed": fixed}


def found(which: str) -> Callable[[], Any]:
    """Return what gives forward dynamics of a problem."""
    return cache(lambda: PROBLEMS[which]().solved())


# What is asked of a chain in a state.


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
of_chain("project", hf.project, inputs=_inputs)
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
of_chain("inverse_dynamics", hf.inverse_dynamics, qdd=_qdd, grasp_wrench=_wrench, inputs=_inputs,
         base_acceleration=_base)
of_chain("regressor", hf.regressor, qdd=_qdd, object_acceleration=_push, inputs=_inputs,
         base_acceleration=_base)
of_chain("linearise", hf.linearise, ("fixed",), tau=_tau, inputs=_inputs, check=_no)
of_chain("linearise a step", hf.linearise, ("fixed",), tau=_tau, inputs=_inputs, step=lambda p: 1e-3, scheme=lambda p: "rk4")
of_chain("grasp_margins", forces.grasp_margins, grasp_wrench=_wrench)
of_chain("joint_margins", forces.joint_margins, tau=_tau)
of_chain("split", forces.split, grasp_wrench=_wrench, length=lambda p: 0.5)
of_chain("largest_margin", forces.largest_margin, result=_result, inputs=_inputs)
of_chain("margin_range", forces.margin_range, result=_result)
of_chain("wrist_wrenches", forces.wrist_wrenches, result=_result)
of_chain("last_joint_wrenches", forces.last_joint_wrenches, result=_result)
of_chain("momentum of a release", lambda chain, state, arm: dynamics.momentum(dynamics.release(chain, arm), state),
         arm=lambda p: "arm1")
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
of_chain("forward_dynamics_jacobian", hf.forward_dynamics_jacobian, ("fixed",), tau=_tau, of=_names("qdd", "grasp_wrench"),
         by=_names("q", "tau"), check=_no)
of_chain("inverse_dynamics_vjp", hf.inverse_dynamics_vjp, base_acceleration=_base, inputs=_inputs, qdd=_qdd, grasp_wrench=_wrench, tau=_tau, by=_names("q", "qd"))
of_chain("inverse_dynamics_jvp", hf.inverse_dynamics_jvp, base_acceleration=_base, inputs=_inputs, qdd=_qdd, grasp_wrench=_wrench, along=lambda p: {"q": _qdd(p)})
of_chain("inverse_dynamics_jacobian", hf.inverse_dynamics_jacobian, base_acceleration=_base, inputs=_inputs, qdd=_qdd, grasp_wrench=_wrench, of=_names("tau"),
         by=_names("q", "grasp_wrench"))
of_chain("closure_vjp", dynamics.closure_vjp, by=_names("q", "object_pose"),
         position=lambda p: np.ones(len(dynamics.closure_jacobian(p.chain, p.state, of=["position"])["position", "q"])))
of_chain("closure_jvp", dynamics.closure_jvp, along=lambda p: {"q": _qdd(p), "object_twist": np.ones(6)})
of_chain("closure_jacobian", dynamics.closure_jacobian, of=_names("position", "velocity"), by=_names("q", "qd"))
of_chain("kinetic_energy_vjp", dynamics.kinetic_energy_vjp, by=_names("q", "qd"), kinetic_energy=lambda p: 1.0)
of_chain("kinetic_energy_jvp", dynamics.kinetic_energy_jvp, along=lambda p: {"q": _qdd(p)})
of_chain("kinetic_energy_jacobian", dynamics.kinetic_energy_jacobian, of=_names("kinetic_energy"), by=_names("q"))
of_chain("potential_energy_vjp", dynamics.potential_energy_vjp, by=_names("q"), potential_energy=lambda p: 1.0)
of_chain("potential_energy_jvp", dynamics.potential_energy_jvp, along=lambda p: {"q": _qdd(p), "gravity": np.ones(3)})
of_chain("potential_energy_jacobian", dynamics.potential_energy_jacobian, of=_names("potential_energy"), by=_names("q"))
of_chain("grasp_margins_vjp", forces.grasp_margins_vjp, grasp_wrench=_wrench, by=_names("grasp_wrench"),
         grasp_margins=lambda p: np.ones(len(p.chain.arms)))
of_chain("grasp_margins_jvp", forces.grasp_margins_jvp, grasp_wrench=_wrench, along=lambda p: {"object_pose": np.ones(6)})
of_chain("grasp_margins_jacobian", forces.grasp_margins_jacobian, grasp_wrench=_wrench, of=_names("grasp_margins"),
         by=_names("grasp_wrench"))
of_chain("joint_margins_vjp", forces.joint_margins_vjp, tau=_tau, by=_names("q", "tau"), effort=_qdd)
of_chain("joint_margins_jvp", forces.joint_margins_jvp, tau=_tau, along=lambda p: {"tau": _qdd(p)})
of_chain("joint_margins_jacobian", forces.joint_margins_jacobian, tau=_tau, of=_names("effort"), by=_names("tau"))
of_chain("wrist_wrenches_vjp", forces.wrist_wrenches_vjp, result=_result, by=_names("q"), wrist_wrenches=_wrench)
of_chain("wrist_wrenches_jvp", forces.wrist_wrenches_jvp, result=_result, along=lambda p: {"q": _qdd(p)})
of_chain("wrist_wrenches_jacobian", forces.wrist_wrenches_jacobian, result=_result, of=_names("wrist_wrenches"),
         by=_names("q"))


# Parts.

POSE = [1.0, 0.0, 0.0, 0.0, 0.1, 0.2, 0.3]
LINK = {"mass": 2.0, "com": np.zeros(3), "inertia": 0.1 * np.eye(3), "name": "body"}
JOINT = {"kind": "revolute", "axis": np.array([0.0, 0.0, 1.0]), "placement": np.array(POSE), "name": "waist",
         "position_limits": (-1.0, 1.0), "stiffness": 3.0, "rest": 0.1, "damping": 0.5}


@call("Trunk", joints=[JOINT, {"axis": np.array([0.0, 1.0, 0.0])}], links=[LINK, LINK], base=np.array(POSE), floating=LINK)
def _trunk(joints: Any, links: Any, base: Any, floating: Any) -> Any:
    made = [hf.Joint(**x) if named(x, hf.Joint) else x for x in joints] if isinstance(joints, list) else joints
    bodies = [hf.Link(**x) if named(x, hf.Link) else x for x in links] if isinstance(links, list) else links
    found = hf.Trunk(made, bodies, base, hf.Link(**floating) if named(floating, hf.Link) else floating)
    return repr(found), found.serial, found.freedoms


@call("Spring", a=("world", np.zeros(3)), b=("arm1", 1, np.ones(3)), stiffness=10.0, length=0.3, damping=1.0,
      chain=Later(lambda: everything().chain), state=Later(lambda: numbers_of(everything().state)))
def _spring(chain: Any, state: Any, **given: Any) -> Any:
    sprung = replace(chain, springs=[hf.Spring(**given)]) if isinstance(chain, hf.ClosedChain) else chain
    return dynamics.potential_energy(sprung, state_of(state))


@call("bushing", kind="bushing", frame=np.array(POSE), stiffness=np.diag([1.0, 2.0, 3.0, 40.0, 50.0, 60.0]),
      damping=np.ones(6))
def _bushing(**given: Any) -> Any:
    return repr(hf.Grasp(**given))


@call("grasp by subspace", kind="subspace", frame=np.array(POSE), motion=np.eye(6)[:, [2, 5]])
def _subspace(**given: Any) -> Any:
    return repr(hf.Grasp(**given))


@call("screw", kind="screw", frame=np.array(POSE), pitch=0.01)
def _screw(**given: Any) -> Any:
    return repr(hf.Grasp(**given))


@call("Anchor", base=np.array(POSE), tip=np.array(POSE), name="pin")
def _anchor(**given: Any) -> Any:
    return repr(hf.Anchor(**given))


@call("State", q=np.zeros(4), qd=np.zeros(4), object_pose=np.array(POSE), object_twist=np.zeros(6),
      base_pose=np.array(POSE), base_twist=np.zeros(6))
def _state(**given: Any) -> Any:
    return repr(hf.State(**given))


@call("ClosedChain", arms=Later(lambda: dict(everything().chain.arms)), held_object=Later(lambda: everything().chain.held_object),
      grasps=Later(lambda: dict(everything().chain.grasps)), gravity=np.array([0.0, 0.0, -9.81]),
      trunk=Later(lambda: everything().chain.trunk), mounts=Later(lambda: dict(everything().chain.mounts)),
      springs=Later(lambda: list(everything().chain.springs)))
def _chain(**given: Any) -> Any:
    return repr(hf.ClosedChain(**given))


@call("assemble", arms=Later(lambda: dict(fixed().chain.arms)), held_object=Later(lambda: fixed().chain.held_object),
      grasps=Later(lambda: dict(fixed().chain.grasps)), q=Later(lambda: {name: np.zeros(arm.joint_count) for name, arm in
                                                                          fixed().chain.arms.items()}),
      gravity=np.array([0.0, 0.0, -9.81]))
def _assemble(**given: Any) -> Any:
    return hf.assemble(**given)


@cache
def rigid() -> Problem:
    """Return two arms that hold the object rigidly."""
    return random_problem(2, joints=(6, 7), grasps=("rigid", "rigid"), moving_base=False, extras=False)


@call("state_from_joints", chain=Later(lambda: rigid().chain), q=Later(lambda: np.array(rigid().state.q)),
      qd=Later(lambda: np.zeros(13)), check=False)
def _from_joints(**given: Any) -> Any:
    return dynamics.state_from_joints(**given)


@call("attach", chain=Later(lambda: fixed().chain.without_grasp("arm1")), state=Later(lambda: numbers_of(fixed().state)),
      name="arm1", grasp=Later(lambda: fixed().chain.grasps["arm1"]), here=False, tolerance=1e-6)
def _attach(state: Any, **given: Any) -> Any:
    return dynamics.attach(state=state_of(state), **given)


@call("inertial_parameters", body=hf.HeldObject.box(1.0, 1.0, 1.0, 1.0))
def _inertial(body: Any) -> Any:
    return dynamics.inertial_parameters(body)


@call("of one arm", arm=Later(lambda: fixed().chain.arms["arm1"]), q=np.zeros(4))
def _of_arm(arm: Any, q: Any) -> Any:
    asked = (dynamics.tip_pose, dynamics.tip_jacobian, dynamics.link_poses, dynamics.joint_mass_matrix)
    return [ask(arm, q) for ask in asked]


# Paths and control.


@call("PoseSpline", poses=[np.array(POSE), hf.Pose.translation(1.0, 0.0, 0.0), hf.Pose.from_rpy(0.0, 0.5, 1.0)],
      times=np.array([0.0, 1.0, 3.0]), t=0.7)
def _spline(poses: Any, times: Any, t: Any) -> Any:
    return control.PoseSpline(poses, times).at(t)


@call("PoseSpline.at_speed", poses=[np.array(POSE), hf.Pose.from_rpy(0.0, 0.5, 1.0)], speed=0.2, turn_rate=0.5, begin=1.0)
def _at_speed(poses: Any, speed: Any, turn_rate: Any, begin: Any) -> Any:
    return control.PoseSpline.at_speed(poses, speed, turn_rate, begin=begin).at(1.5)


@call("RestToRest", start=np.array(POSE), displacement=np.ones(3), turn=np.ones(3), begin=0.1, duration=2.0, t=0.7)
def _rest(t: Any, **given: Any) -> Any:
    return control.RestToRest(**given).at(t)


@call("CarriedBase", start=np.array(POSE), displacement=np.ones(3), turn=np.ones(3), frame=np.array(POSE), t=0.7)
def _carried(start: Any, displacement: Any, turn: Any, frame: Any, t: Any) -> Any:
    return hf.simulation.CarriedBase(control.RestToRest(start, displacement, turn), frame)(t)


@call("TorqueSchedule", knots=np.array([0.0, 1.0]), coefficients=[np.ones((10, 2)), np.ones((10, 3))], t=1.5,
      state=Later(lambda: numbers_of(fixed().state)))
def _schedule(knots: Any, coefficients: Any, t: Any, state: Any) -> Any:
    made = control.TorqueSchedule(knots, coefficients)
    return made(t, state_of(state), None), made.breakpoints


@call("TorqueSchedule.linear", times=np.array([0.0, 1.0]), torques=np.ones((2, 10)), t=0.5)
def _linear(times: Any, torques: Any, t: Any) -> Any:
    return control.TorqueSchedule.linear(times, torques)(t, fixed().state, None)


@call("ObjectTracking", squeeze=1.0, stiffness=100.0, damping=20.0, joint_damping=1.0, t=0.5,
      state=Later(lambda: numbers_of(fixed().state)))
def _tracking(t: Any, state: Any, **given: Any) -> Any:
    p = fixed()
    law = control.ObjectTracking(p.chain, control.RestToRest(p.state.object_frame, [0.1, 0.0, 0.0]), **given)
    return law(t, state_of(state), None)


@call("GravityCompensation", squeeze=1.0, joint_damping=1.0, state=Later(lambda: numbers_of(fixed().state)))
def _compensation(state: Any, **given: Any) -> Any:
    return control.GravityCompensation(fixed().chain, **given)(0.0, state_of(state), None)


@call("holding_law", chain=Later(lambda: fixed().chain), each_arm=False, acceleration=np.zeros(6), internal=3.0,
      state=Later(lambda: numbers_of(fixed().state)))
def _holding(chain: Any, each_arm: Any, state: Any, **given: Any) -> Any:
    return control.holding_law(chain, each_arm=each_arm).given(given)(0.0, state_of(state), None)


def stay(t: Any, state: Any, memory: Any, given: Any) -> tuple[Any, Any]:
    """Return torques that pull joints back, and a memory that counts."""
    return -given["gain"] * state.q - 2.0 * state.qd, memory + 1.0


@call("ControlLaw", memory=np.zeros(2), parameters={"gain": (), "target": (3,)}, key="k",
      values={"gain": 2.0, "target": np.zeros(3)})
def _law(memory: Any, parameters: Any, key: Any, values: Any) -> Any:
    law = hf.ControlLaw(stay, memory, parameters, key)
    return law.given(values)(0.0, fixed().state, None)


@call("clipped", chain=Later(lambda: fixed().chain), torques=np.ones(10))
def _clipped(chain: Any, torques: Any) -> Any:
    return control.clipped(lambda t, state, memory: (torques, memory), chain)(0.0, fixed().state, None)
