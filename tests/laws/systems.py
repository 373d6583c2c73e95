"""Random systems with everything on, solved once."""

from __future__ import annotations

from functools import cache

import numpy as np

from holdfast import Arm, ClosedChain, ForwardResult, Inputs, State, forward_dynamics
from tests.dynamics.problems import random_problem
from tests.systems.as_chain import Problem

MIXED = {"grasps": ("rigid", "hinge", None, "softfinger", "ball"), "joints": (6, 7, 4, 8, 7), "moving_base": True}


def solved(p: Problem, **options) -> ForwardResult:
    """Return forward dynamics of a problem."""
    return forward_dynamics(p.chain, p.state, p.tau, inputs=p.inputs, **options)


@cache
def sample(seed: int) -> tuple[Problem, ForwardResult]:
    """Return one of many systems: 1 to 8 arms of 3 to 12 joints, any grasps, bases moving in two of three."""
    p = random_problem(seed, moving_base=seed % 3 > 0)
    return p, solved(p)


@cache
def mixed(seed: int) -> tuple[Problem, ForwardResult]:
    """Return five arms with every kind of grasp, one of them free, everything on."""
    p = random_problem(seed, **MIXED)
    return p, solved(p)


def with_arms(chain: ClosedChain, arms: dict[str, Arm]) -> ClosedChain:
    """Return the chain with other arms."""
    return ClosedChain(arms, chain.held_object, chain.grasps, chain.gravity)


def reordered(p: Problem, names: list[str]) -> Problem:
    """Return the same system with its arms in another order."""
    chain = p.chain
    joints = np.concatenate([np.arange(len(p.tau))[chain.joints[name]] for name in names])
    rows = [chain.names.index(name) for name in names]
    given = p.inputs.shaped(chain)
    return Problem(
        with_arms(chain, {name: chain.arms[name] for name in names}),
        State(p.state.q[joints], p.state.qd[joints], p.state.object_pose, p.state.object_twist),
        p.tau[joints],
        Inputs(
            given.object_wrench,
            None if given.link_wrenches is None else given.link_wrenches[joints],
            given.base_twists[rows],
            given.base_accelerations[rows],
        ),
    )
