"""A chain a moment later, bases included, by finite rotations."""

import numpy as np

from holdfast import ClosedChain, Pose, State
from holdfast.dynamics.projection import moved
from holdfast.spatial import rotation
from tests.systems.as_chain import Problem


def later(p: Problem, dt: float) -> tuple[ClosedChain, State]:
    """Return chain and state moved along their velocities for dt, to first order."""
    twists = p.inputs.shaped(p.chain).base_twists
    bases = {
        name: Pose(rotation.exp(dt * V[:3]) @ arm.base.R, arm.base.p + dt * V[3:])
        for (name, arm), V in zip(p.chain.arms.items(), twists, strict=True)
    }
    return p.chain.with_bases(bases), moved(p.state, dt * p.state.qd, dt * p.state.object_twist)


def pushed(p: Problem, dx) -> State:
    """Return the state with the object displaced by [turn; shift], nothing else."""
    return moved(p.state, np.zeros(p.chain.joint_count), np.asarray(dx, dtype=float))
