"""Random and stored systems in motion, as a whole and arm by arm."""

from __future__ import annotations

from functools import cache

import numpy as np

from holdfast import ClosedChain, Pose, State
from holdfast.dynamics.arm.motion import ArmInputs, ArmMotion, arm_motion
from holdfast.dynamics.closed.chain_motion import ChainMotion, chain_motion, pseudo_gravity
from holdfast.dynamics.projection import moved
from holdfast.spatial import rotation
from tests.systems import random_system
from tests.systems.as_chain import Problem, as_chain
from tests.systems.problems import CASES, random_case, random_problem, relative_gap, stored

__all__ = ["CASES", "inputs_of", "later", "motion_of", "pushed", "random_arm", "random_case", "random_motion",
           "random_problem", "relative_gap", "stored"]  # fmt: skip


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


def later(p: Problem, dt: float) -> tuple[ClosedChain, State]:
    """Return chain and state moved along their velocities for dt, to first order."""
    twists = p.inputs.shaped(p.chain).base_twists
    bases = {
        name: Pose(rotation.exp(dt * V[:3]) @ arm.base.R, arm.base.p + dt * V[3:])
        for (name, arm), V in zip(p.chain.arms.items(), twists, strict=True)
    }
    return p.chain.with_bases(bases), moved(p.state, dt * np.r_[p.state.qd, p.state.object_twist])


def pushed(p: Problem, dx) -> State:
    """Return the state with the object displaced by [turn; shift], nothing else."""
    return moved(p.state, np.r_[np.zeros(p.chain.joint_count), np.asarray(dx, dtype=float)])
