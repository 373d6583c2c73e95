"""Chains whose code leaves the library, and what the library's own calls say of many systems."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np

import holdfast as hf
from holdfast.codegen.functions import ExportedFunction, exported_function, exported_law
from holdfast.codegen.header import CARRIED_PREFIX
from holdfast.compiled.derivative_schedule import FOUND, UNITS
from holdfast.control import compile_law
from holdfast.simulation.rollout.varied_step import LAW_PREFIX
from holdfast.spatial.scalar import sin
from tests.compiled.problems import one
from tests.questions.every import direct, inputs_of
from tests.systems.problems import random_problem
from tests.systems.trunk_problems import cases

System = dict[str, np.ndarray]
LAW, GAIN, STEP = "hold", 3.0, 1e-3

# Ten chains: every kind of grasp, arms of one type and of several, free arms, trunks that stand and that float.
DRAWN: dict[str, tuple[int, dict[str, Any]]] = {
    "two of seven": (1, {"joints": 7, "grasps": ("rigid", "rigid")}),
    "three kinds": (2, {"joints": 6, "grasps": ("rigid", "hinge", "ball")}),
    "soft fingers": (3, {"joints": 5, "grasps": ("softfinger",) * 3}),
    "five balls": (4, {"joints": 4, "grasps": ("ball",) * 5}),
    "one holds": (5, {"joints": 6, "grasps": ("rigid", None)}),
    "one": (6, {"joints": 6, "grasps": ("rigid",)}),
    "four": (7, {"joints": 7, "grasps": ("rigid",) * 4}),
    "hinges": (8, {"joints": 7, "grasps": ("hinge", "hinge")}),
}
STORED = {"torso": "torso1_rigid_7_7", "floating": "floating_torso3_gravity_mixed"}
NAMES = (*DRAWN, *STORED)


@cache
def chain_and_state(name: str) -> tuple[hf.ClosedChain, hf.State]:
    """Return one of the ten, and a state on its grasps."""
    if name in STORED:
        case = cases()[STORED[name]]
        return case.chain, case.state
    seed, options = DRAWN[name]
    found = random_problem(seed, moving_base=False, **options)
    return found.chain, found.state


def remembering_law(n: int) -> hf.ControlLaw:
    """Return a law with a parameter and a memory: proportional and integral, of sines of angles."""

    def torque(t, state, memory, given):
        error = np.array([sin(x) for x in state.q], dtype=object)
        return -given["gain"] * error - memory - 0.1 * t * state.qd, memory + 1e-3 * error

    return hf.ControlLaw(torque, parameters={"gain": ()}, memory=np.zeros(n))


class Truth(NamedTuple):
    """A function of a chain, systems that it is run on, and what the library says.

    Attributes:
        function: that is exported.
        given: of every system, its arrays.
        expected: of every system, results, and what is `returned`.
    """

    function: ExportedFunction
    given: list[System]
    expected: list[System]


@cache
def truths(name: str, count: int, derivatives: bool = True) -> list[Truth]:
    """Return functions of a chain, and the library's answers for so many systems, by its public calls."""
    chain, state = chain_and_state(name)
    compiled = hf.compile(chain)
    made = [_forward(compiled, state, count), _law(compiled, state, count)]
    made += [answer(question, compiled, state, count) for question in direct()]
    made += [_jacobian(compiled, state, count)] if derivatives else []
    return [*made, steps(compiled, state, count)]


def _near(chain: hf.ClosedChain, state: hf.State, k: int) -> System:
    """Return a state beside another one, grasps open or not; the first is the state itself."""
    random, away = np.random.default_rng(k), 0.0 if k == 0 else 0.3
    n = chain.joint_count
    pose = np.array(state.object_pose)
    pose[:4] += away * random.normal(size=4)
    pose[:4] /= np.linalg.norm(pose[:4])
    found = {
        "q": state.q + away * random.normal(size=n),
        "qd": state.qd + away * random.normal(size=n),
        "object_pose": pose,
        "object_twist": state.object_twist + away * random.normal(size=6),
    }
    if chain.floats:
        found |= {"floating_pose": state.base_pose, "floating_twist": state.base_twist + away * random.normal(size=6)}
    return found


def _by_name(chain: hf.ClosedChain, system: System) -> tuple[list[np.ndarray], System]:
    """Return a state as positional arguments, and what goes by name."""
    names = ("q", "qd", "object_pose", "object_twist")
    return [system[n] for n in names], {n: x for n, x in system.items() if n not in names}


def _forward(compiled, state, count) -> Truth:
    function, chain = exported_function("forward_dynamics", compiled, state), compiled.chain
    given, expected = [], []
    for k in range(count):
        system = _near(chain, state, k) | {"tau": np.random.default_rng((k, 1)).normal(size=chain.joint_count)}
        (q, qd, pose, twist), rest = _by_name(chain, system)
        try:
            found = compiled.forward_dynamics(q, qd, system["tau"], pose, twist, **_without(rest, "tau"))
        except hf.errors.SingularChainError:
            continue
        rank = function.values["generic_rank"]
        names = [n for n, e in function.externals.items() if e.role == "output" and e.size]
        given.append(system | {"generic_rank": rank})
        expected.append({n: found.array(n) for n in names} | {"returned": found.array("status")})
    return Truth(function, given, expected)


def _without(system: System, *names: str) -> System:
    return {n: x for n, x in system.items() if n not in names}


def answer(name: str, compiled: hf.compiled.CompiledChain, state: hf.State, count: int) -> Truth:
    """Return a question that is answered without the equations of motion; what is projected is nearly closed."""
    function, call, near = exported_function(name, compiled), getattr(compiled, name), name != "project"
    given, expected = [], []
    for k in range(count):
        system = one(inputs_of(compiled.chain, 1, k), 0) | _near(compiled.chain, state, k if near else 0)
        if not near:
            system["q"] = state.q + 1e-4 * k / count
        system = _only(system, *call.question.inputs, *call.question.by_name(compiled.chain))
        result = call.results(None)
        call.calls(system, result)
        given.append(system)
        found = {x: result.array(x) for x in call.question.names_at(compiled.chain)}
        expected.append(found | {"returned": np.array(0)})
    return Truth(function, given, expected)


def _only(system: System, *names: str) -> System:
    return {n: x for n, x in system.items() if n in names}


def _law(compiled, state, count) -> Truth:
    law = remembering_law(compiled.chain.joint_count).given({"gain": GAIN})
    function, made = exported_law(LAW, law, compiled), compile_law(law, compiled.chain)
    given, expected = [], []
    for k in range(count):
        random = np.random.default_rng((k, 3))
        system = _near(compiled.chain, state, k)
        args, rest = _by_name(compiled.chain, system)
        own = {"t": np.array(0.01 * k), "memory": random.normal(size=compiled.chain.joint_count)}
        found = made.torques(own["t"], *args, memory=own["memory"], **rest)
        given.append(system | own)
        expected.append({"tau": found.tau, "kept": found.memory, "returned": np.array(0)})
    return Truth(function, given, expected)


def _jacobian(compiled, state, count) -> Truth:
    function = exported_function("forward_dynamics_jacobian", compiled, state)
    chain, names = compiled.chain, ("q", "qd", "tau")
    given, expected = [], []
    for k in range(max(1, count // 10)):
        system = _near(chain, state, 0) | {"tau": np.random.default_rng((k, 4)).normal(size=chain.joint_count)}
        args, rest = _by_name(chain, system)
        q, qd, pose, twist = args
        found = compiled.forward_dynamics_jacobian(
            q, qd, system["tau"], pose, twist, of=("qdd",), by=names, **_without(rest, "tau")
        )
        given.append(system | {"generic_rank": function.values["generic_rank"], UNITS: function.values[UNITS]})
        expected.append({f"{FOUND}qdd.{n}": found.result.array(f"{FOUND}qdd.{n}") for n in names})
    return Truth(function, given, expected)


def steps(compiled, state, count, base_motion=None) -> Truth:
    """Return a run's steps: what was carried before each, and after."""
    chain = compiled.chain
    function = exported_function("step", compiled, state, base_motion=base_motion)
    rollout = hf.compile_rollout(chain, generic_rank=None, base_motion=base_motion)
    of_base = {"floating_pose": state.base_pose, "floating_twist": state.base_twist} if chain.floats else {}
    systems = rollout.start(
        state.q, state.qd, state.object_pose, state.object_twist, tau=np.zeros(chain.joint_count), **of_base
    )
    given, expected = [], []
    for k in range(count):
        if k % 50 == 49:  # again from the state, so that no run wanders off
            systems = rollout.start(
                state.q, state.qd, state.object_pose, state.object_twist, tau=np.zeros(chain.joint_count), **of_base
            )
        tau = np.random.default_rng((k, 5)).normal(size=chain.joint_count)
        before = {f"{CARRIED_PREFIX}{n}": x[0].copy() for n, x in systems.arrays.items()}
        rollout.step(systems, STEP, tau=tau)
        if not systems.running.all():
            break
        given.append(before | {f"{LAW_PREFIX}tau": tau, "step": np.array(STEP)})
        after = {
            name: x[0].copy()
            for n, x in systems.arrays.items()
            if (name := f"{CARRIED_PREFIX}{n}") in function.externals
        }
        expected.append(after | {"returned": np.array(0)})
    assert len(given) > count // 2
    return Truth(function, given, expected)
