"""Stored cases with a trunk, and random chains put on one."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

import holdfast
from holdfast import ClosedChain, Inputs, Joint, Link, Pose, State, Trunk
from holdfast.dynamics import project_velocity
from holdfast.dynamics.trunk.trunk_motion import trunk_at_rest
from holdfast.spatial import rotation
from tests.systems.as_chain import Problem
from tests.systems.problems import random_problem
from tests.systems.stored_cases import stored_cases


def cases():
    """Return the stored cases by name."""
    return stored_cases("cases_trunk.json")


def names():
    """Return the names of the stored cases, for parameters of tests."""
    return [*cases()]


def random_body(random) -> Link:
    """Return a link of some kilograms."""
    R = rotation.exp(random.normal(size=3))
    return Link(random.uniform(1, 10), 0.1 * random.normal(size=3), R @ np.diag([0.1, 0.12, 0.15]) @ R.T)


def random_pose(random) -> Pose:
    """Return a pose, origins a few decimetres apart."""
    return Pose(rotation.exp(random.normal(size=3)), 0.3 * random.normal(size=3))


def random_trunk(random, joints: int, *, floating: bool) -> Trunk:
    """Return a trunk of turning and sliding joints with drives."""
    kinds = ["prismatic" if random.random() < 0.2 else "revolute" for _ in range(joints)]
    axes = [rotation.exp(random.normal(size=3))[:, 0] for _ in range(joints)]
    made = [
        Joint(
            kind,
            axis,
            random_pose(random),
            armature=random.uniform(0, 0.5),
            damping=random.uniform(0, 2),
            stiffness=random.uniform(0, 20),
            rest=random.normal(),
        )
        for kind, axis in zip(kinds, axes, strict=True)
    ]
    links = [replace(random_body(random), name=f"body{k}") for k in range(joints)]
    return Trunk(made, links, random_pose(random), random_body(random) if floating else None)


def on_trunk(problem: Problem, seed: int, joints: int, *, floating: bool = False, in_world: float = 0.2) -> Problem:
    """Return a problem with its arms on the bodies of a random trunk, each where its base was; some stay in the world.

    Velocities are new: near random ones, and such that the grasps stay closed.
    """
    random = np.random.default_rng(seed)
    trunk = random_trunk(random, joints, floating=floating)
    q = np.r_[random.uniform(-1, 1, joints), problem.state.q]
    qd = np.r_[random.normal(size=joints), problem.state.qd]
    base = {"base_pose": random_pose(random), "base_twist": random.normal(size=6)} if floating else {}
    state = State(q, qd, problem.state.object_pose, problem.state.object_twist, **base)
    alone = ClosedChain(problem.chain.arms, problem.chain.held_object, {}, problem.chain.gravity, trunk)
    placed = trunk_at_rest(alone, state)
    first = 1 if floating else 0
    mounts, bases = {}, {}
    for name, arm in problem.chain.arms.items():
        if random.random() >= in_world:
            k = int(random.integers(len(placed.bodies)))
            mounts[name] = "base" if k < first else k - first
            bases[name] = placed.bodies[k].frame.inverse() @ arm.base
    chain = ClosedChain(
        problem.chain.with_bases(bases).arms,
        problem.chain.held_object,
        problem.chain.grasps,
        problem.chain.gravity,
        trunk,
        mounts,
    )
    inputs = Inputs(
        object_wrench=random.normal(size=6),
        link_wrenches=random.normal(size=(len(problem.state.q), 6)),
        trunk_link_wrenches=random.normal(size=(len(trunk.bodies), 6)),
        trunk_base_twist=None if floating else random.normal(size=6),
        trunk_base_acceleration=None if floating else random.normal(size=6),
    )
    state = project_velocity(chain, state, inputs=inputs)
    return Problem(chain, state, random.normal(size=chain.joint_count), inputs)


@cache
def random_on_trunk(seed: int, joints: int, *, floating: bool = False, **options) -> Problem:
    """Return a random chain on a random trunk."""
    return on_trunk(random_problem(seed, moving_base=False, **options), seed, joints, floating=floating)


def in_machine_code(p: Problem):
    """Return forward dynamics by machine code; wrenches on links and driven bases are run-time parameters."""
    return holdfast.compile(p.chain, parameters=["link_wrench"]).forward_dynamics(**p.arguments)
