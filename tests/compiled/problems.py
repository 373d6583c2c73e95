"""Chains to compile, numbers to run them on, and answers compared with the reference."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

import holdfast
from holdfast import ClosedChain, Grasp, Inputs, Pose, State
from holdfast.compiled import CompiledChain
from holdfast.compiled.result import CompiledResult
from holdfast.compiler.interpret import interpret_schedule
from holdfast.dynamics import ForwardResult
from holdfast.dynamics.arm.forward_kinematics import forward_kinematics
from holdfast.model.arm import Arm
from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array
from tests.acceptance.comparison import disagreement
from tests.systems import random_system
from tests.systems.as_chain import Problem, as_chain

Given = dict[str, Any]  # arguments by name
FIELDS = ("qdd", "grasp_wrench", "object_acceleration", "contact_acceleration", "base_wrench")
STATE = ("q", "qd", "tau", "object_pose", "object_twist")

# Joint count and grasp of each arm; arms with the same of both are of one type.
CHAINS: dict[str, tuple[tuple[int, str | None], ...]] = {
    "one": ((7, "rigid"),),
    "two": ((7, "rigid"), (7, "rigid")),
    "interleaved": ((6, "rigid"), (4, "ball"), (6, "rigid"), (4, "ball"), (6, "rigid")),
    "rows first": ((5, "rigid"), (5, "hinge"), (6, "rigid"), (4, None), (5, "rigid"), (6, "rigid")),
    "factors only": ((4, "softfinger"), (3, "ball"), (5, "rigid"), (4, "softfinger")),
    "all kinds": ((7, "rigid"), (5, "hinge"), (4, "softfinger"), (3, "ball"), (3, None)),
    "nobody holds": ((3, None), (4, None), (3, None)),
    "nine": ((3, "ball"),) * 9,
}


@cache
def part(joint_count: int, kind: str | None) -> Arm:
    """Return an arm of revolute and prismatic joints, with armature and damping."""
    made = as_chain(random_system(100 * joint_count + len(kind or ""), arms=1, joints=joint_count)).chain.arms["arm1"]
    if joint_count < 7:
        return made
    joints = list(made.joints)  # a wrist of revolute joints with one that slides below it
    joints[2] = replace(joints[2], kind="prismatic")
    return replace(made, joints=joints)


@cache
def chain_named(name: str) -> ClosedChain:
    """Return one of `CHAINS` with random bases, contacts and an ordinary object."""
    return chain_of(CHAINS[name], len(name))


def chain_of(arms: tuple[tuple[int, str | None], ...], seed: int = 0) -> ClosedChain:
    """Return arms of the given joint counts and grasps around one object."""
    random = np.random.default_rng(seed)
    names = [f"arm{k}" for k in range(len(arms))]
    placed = {name: part(*of).at(pose(random, 1.0)) for name, of in zip(names, arms, strict=True)}
    kinds = {name: kind for name, (_, kind) in zip(names, arms, strict=True) if kind}
    grasps = {name: Grasp(kind, pose(random, 0.3)) for name, kind in kinds.items()}  # type: ignore[arg-type]
    held = as_chain(random_system(seed, arms=1, joints=3)).chain.held_object
    return ClosedChain(placed, held, grasps, random.normal(size=3) * 6.0)


def pose(random: np.random.Generator, spread: float) -> Pose:
    """Return a random pose."""
    return Pose(rotation.from_quaternion(_unit(random.normal(size=4))), spread * random.normal(size=3))


@cache
def compiled(name: str, method: str = "auto") -> CompiledChain:
    """Return one of `CHAINS` as machine code, with every optional parameter."""
    return holdfast.compile(chain_named(name), method=method, parameters=("link_inertia", "link_wrench"))


def numbers(chain: ClosedChain, batch: int, seed: int = 0) -> Given:
    """Return random states and torques, whose grasps need not be closed, by the names of the arguments."""
    random, n = np.random.default_rng(seed), chain.joint_count
    quaternions = random.normal(size=(batch, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1)[:, None]
    return {
        "q": random.uniform(-2, 2, (batch, n)),
        "qd": random.normal(size=(batch, n)),
        "tau": 5.0 * random.normal(size=(batch, n)),
        "object_pose": np.hstack([quaternions, random.normal(size=(batch, 3))]),
        "object_twist": random.normal(size=(batch, 6)),
    }


def forces(chain: ClosedChain, batch: int, seed: int = 0) -> Given:
    """Return random external wrenches and base motions by the names of the arguments."""
    random, n, l = np.random.default_rng((seed, 1)), chain.joint_count, len(chain.arms)
    shapes = {"object_wrench": (6,), "link_wrench": (n, 6), "base_twist": (l, 6), "base_acceleration": (l, 6)}
    return {name: random.normal(size=(batch, *shape)) for name, shape in shapes.items()}


def one(given: Given, i: Any) -> Given:
    """Return the i-th system of a batch."""
    return {name: x[i] for name, x in given.items()}


def reference(chain: ClosedChain, given: Given, **options) -> ForwardResult:
    """Return the reference's answer for one system; its grasps need not be closed."""
    state = State(*(given[name] for name in ("q", "qd", "object_pose", "object_twist")))
    fields = ("object_wrench", "link_wrench", "base_twist", "base_acceleration")
    inputs = Inputs(*(given.get(name) for name in fields))
    return holdfast.forward_dynamics(chain, state, given["tau"], inputs=inputs, check=False, **options)


def given_by(problem: Problem) -> Given:
    """Return a problem's numbers by the names of the arguments; what is zero anyhow is left out."""
    s, i = problem.state, problem.inputs.shaped(problem.chain)
    found = {"q": s.q, "qd": s.qd, "tau": problem.tau, "object_pose": s.object_pose, "object_twist": s.object_twist}
    acting = {"object_wrench": i.object_wrench, "link_wrench": i.link_wrenches}
    acting |= {"base_twist": i.base_twists, "base_acceleration": i.base_accelerations}
    return found | {name: x for name, x in acting.items() if x is not None and x.any()}


def compiled_for(problem: Problem, **options) -> tuple[CompiledChain, Given]:
    """Return a problem's chain as machine code, and its numbers."""
    given = given_by(problem)
    return holdfast.compile(problem.chain, parameters=[n for n in given if n == "link_wrench"], **options), given


def answer(problem: Problem, **options) -> CompiledResult:
    """Return the compiled answer of a problem."""
    fast, given = compiled_for(problem, **options)
    return fast.forward_dynamics(**given)


def interpreted(fast: CompiledChain, given: Given) -> tuple[Array, ...]:
    """Return the outputs by the graph's interpreter, number by number in Python."""
    function = fast.forward_dynamics
    calls = (function.when_moving if {"base_twist", "base_acceleration"} & {*given} else function).calls
    return tuple(interpret_schedule(calls.kernel.schedule, calls.own | given).values())


def outputs(result: CompiledResult, i: Any = None) -> tuple[Array, ...]:
    """Return all outputs, or those of the i-th system of a batch."""
    found = [result.array(name) for name in result.layout.shapes]
    return tuple(x if i is None else x[i] for x in found)


def closed_again(problem: Problem, case: dict, seed: object) -> Problem:
    """Return the problem in another closed state: the bases follow, velocities are projected.

    The case dict is changed with it, positions only.
    """
    random, chain = np.random.default_rng(seed), problem.chain  # type: ignore[arg-type]
    q = problem.state.q + random.uniform(-0.7, 0.7, chain.joint_count)
    at = pose(random, 0.5)
    bases = {}
    for name, grasp in chain.grasps.items():
        tip = forward_kinematics(chain.arms[name].at(Pose.identity()), q[chain.joints[name]]).tip
        bases[name] = at @ grasp.frame @ tip.inverse()
    chain = chain.with_bases(bases)
    given = problem.inputs.shaped(chain)
    state = State(q, random.normal(size=len(q)), at.wxyz_xyz, random.normal(size=6))
    state = holdfast.dynamics.project_velocity(chain, state, inputs=given)
    case["object"] |= {"R": at.R.tolist(), "p": at.p.tolist()}
    for arm, (name, made) in zip(case["arms"], chain.arms.items(), strict=True):
        arm["base"] |= {"R": made.base.R.tolist(), "p": made.base.p.tolist()}
        arm["q"] = q[chain.joints[name]].tolist()
    return Problem(chain, state, 5.0 * random.normal(size=len(q)), given)


def relative_disagreement(result: CompiledResult, expected: ForwardResult) -> float:
    """Return the largest difference over all fields, rank and status included, relative to max(1, size)."""
    same = result.rank == expected.rank and result.status is expected.status
    close = abs(result.condition - expected.condition) <= 1e-9 * expected.condition
    return disagreement(result, expected) if same and close else np.inf


def _unit(x: Array) -> Array:
    return x / np.linalg.norm(x)
