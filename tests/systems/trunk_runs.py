"""Chains on a trunk that can be run, and motions of a trunk's base."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import holdfast as hf
from holdfast.dynamics import project_velocity
from holdfast.model.force_element import SpringEnd
from holdfast.spatial import rotation
from tests.systems.as_chain import Problem
from tests.systems.problems import random_problem
from tests.systems.trunk_problems import on_trunk


def still_base(seed: int, joints: int, *, floating: bool, arms: dict | None = None, **options) -> Problem:
    """Return a random chain whose trunk begins in the world at rest, or floats; velocities keep the grasps.

    Args:
        seed: of the random numbers.
        joints: of the trunk.
        floating: whether its base floats.
        arms: options of `random_problem`, for the arms and what they hold.
        **options: of `on_trunk`.
    """
    p = on_trunk(random_problem(seed, moving_base=False, **(arms or {})), seed, joints, floating=floating, **options)
    inputs = hf.Inputs(object_wrench=p.inputs.object_wrench)
    return replace(p, state=project_velocity(p.chain, p.state), inputs=inputs)


def swaying(base: hf.Pose):
    """Return the motion of a base that turns about a slanted axis while it is shaken, at rest at t = 0."""
    axis = np.array([0.6, 0.0, 0.8])

    def motion(t):
        shift, speed, change = np.array([t**3, -(t**2), 0]), np.array([3 * t**2, -2 * t, 0]), np.array([6 * t, -2, 0])
        pose = hf.Pose(rotation.exp(2 * t**2 * axis) @ base.R, base.p + shift)
        return pose, np.r_[4 * t * axis, speed], np.r_[4 * axis, change]

    return motion


def one_long_arm(seed: int, below: int) -> tuple[Problem, Problem]:
    """Return a chain of two arms, and the same chain with the first joints of one of them as the trunk of its rest."""
    p = random_problem(seed, arms=2, joints=8, moving_base=False)
    p = replace(p, state=project_velocity(p.chain, p.state), inputs=hf.Inputs())
    return p, with_first_joints_as_trunk(p, below)[0]


def with_first_joints_as_trunk(p: Problem, below: int) -> tuple[Problem, np.ndarray]:
    """Return a chain with the first joints of its second arm as the trunk of that arm's rest, and its joints' order."""
    name = p.chain.names[1]
    arm, part = p.chain.arms[name], p.chain.joints[name]
    trunk = hf.Trunk(arm.joints[:below], arm.links[:below], arm.base)
    rest = replace(arm, joints=arm.joints[below:], links=arm.links[below:], base=hf.Pose.identity())
    order = np.r_[part.start : part.start + below, : part.start, part.start + below : p.chain.joint_count]

    def end(of: SpringEnd) -> SpringEnd:
        if of.body != name:
            return of
        k = of.link_number()
        return SpringEnd("trunk", of.point, k) if k < below else SpringEnd(name, of.point, k - below)

    chain = hf.ClosedChain(
        {**p.chain.arms, name: rest},
        p.chain.held_object,
        p.chain.grasps,
        p.chain.gravity,
        trunk,
        {name: below - 1},
        springs=[replace(spring, a=end(spring.a), b=end(spring.b)) for spring in p.chain.springs],
    )
    state = replace(p.state, q=p.state.q[order], qd=p.state.qd[order])
    return Problem(chain, state, p.tau[order], p.inputs), order
