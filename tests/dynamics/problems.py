"""The stored cases and random systems as library objects, arm by arm."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np

from holdfast.dynamics.arm.motion import ArmInputs, ArmMotion, arm_motion
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion, pseudo_gravity
from tests.systems import random_system, well_conditioned_system
from tests.systems.as_chain import Problem, as_chain

CASES = {
    case["name"]: case for case in json.loads((Path(__file__).parents[1] / "data" / "cases.json").read_text())["cases"]
}
REGULAR = [name for name, case in CASES.items() if case["tags"]["omega_regular"]]
RIGID = [name for name in REGULAR if CASES[name]["tags"]["all_rigid"]]


def relative_gap(got, expected) -> float:
    """Return the largest difference relative to the largest expected entry."""
    got, expected = np.asarray(got, dtype=float), np.asarray(expected, dtype=float)
    assert got.shape == expected.shape
    size = np.abs(expected).max(initial=0.0)
    # an expected zero gives nothing to be relative to
    return float(np.abs(got - expected).max(initial=0.0) / (size if size > 1e-9 else 1.0))


@cache
def stored(name: str) -> Problem:
    """Return a stored case."""
    return as_chain(CASES[name])


@cache
def random_case(seed: int, **options) -> dict:
    """Return a sound random system with everything on (one dict: do not change it)."""
    return well_conditioned_system(seed, **options)


@cache
def random_problem(seed: int, **options) -> Problem:
    """Return a sound random system as library objects."""
    return as_chain(random_case(seed, **options))


def motion_of(problem: Problem) -> ChainMotion:
    """Return the whole chain in motion."""
    return chain_motion(problem.chain, problem.state, problem.tau, problem.inputs.shaped(problem.chain))


def inputs_of(problem: Problem, name: str) -> ArmInputs:
    """Return what one arm is given, gravity in the base acceleration."""
    chain, state = problem.chain, problem.state
    given = problem.inputs.shaped(chain)
    part, i = chain.joints[name], chain.names.index(name)
    return ArmInputs(
        chain.arms[name],
        state.q[part],
        state.qd[part],
        problem.tau[part],
        given.base_twists[i],
        given.base_accelerations[i] - pseudo_gravity(chain),
        None if given.link_wrenches is None else given.link_wrenches[part],
    )


@cache
def random_arm(seed: int, **options) -> ArmInputs:
    """Return an arm of 3 to 12 joints, some prismatic, on a moving base, with everything acting on it."""
    case = random_system(seed, **{"arms": 1, "moving_base": True, "gravity": (1.0, -2.0, -9.0)} | options)
    return inputs_of(as_chain(case), "arm1")


@cache
def random_motion(seed: int, **options) -> ArmMotion:
    """Return the same arm in motion."""
    return arm_motion(random_arm(seed, **options))
