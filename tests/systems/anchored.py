"""Random chains whose object is pinned by anchors too: to the world, to moving places, to a trunk."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from holdfast import Anchor, Inputs, Pose, Trunk
from holdfast.dynamics import project_velocity
from holdfast.dynamics.trunk.trunk_motion import trunk_at_rest
from holdfast.spatial import rotation
from tests.systems.as_chain import Problem
from tests.systems.lower_pairs import grasp_of
from tests.systems.problems import random_problem


def pinned(p: Problem, kinds: tuple[str, ...], seed: int = 0, *, moving: bool = True, lever: bool = True) -> Problem:
    """Return a problem with an anchor more for each kind of grasp, where the object is, velocities projected.

    Args:
        p: a problem without a trunk.
        kinds: of the anchors' grasps.
        seed: of where they are and how they move.
        moving: whether they do.
        lever: whether their tips are off their bases.
    """
    random, chain, given = np.random.default_rng(seed), p.chain, p.inputs.shaped(p.chain)
    arms, grasps = {**chain.arms}, {**chain.grasps}
    for k, kind in enumerate(kinds, start=1):
        frame = Pose(rotation.exp(random.normal(size=3)), 0.2 * random.normal(size=3))
        tip = Pose(rotation.exp(random.normal(size=3)), 0.3 * random.normal(size=3)) if lever else Pose.identity()
        grasp = grasp_of(kind, frame)
        arms[f"pin{k}"] = Anchor(p.state.object_frame @ frame @ tip.inverse(), tip=tip)
        grasps[f"pin{k}"] = grasp
    chain = replace(chain, arms=arms, grasps=grasps)
    moves = 0.5 * random.normal(size=(2, len(kinds), 6)) * (1.0 if moving else 0.0)
    inputs = replace(
        given,
        base_twists=np.concatenate([given.base_twists, moves[0]]),
        base_accelerations=np.concatenate([given.base_accelerations, moves[1]]),
    )
    return Problem(chain, project_velocity(chain, p.state, inputs=inputs), p.tau, inputs)


def pinned_to_trunk(p: Problem, kind: str, seed: int = 0) -> Problem:
    """Return a problem with a trunk, the object pinned to its outermost body besides, velocities projected."""
    random, given = np.random.default_rng(seed), p.inputs.shaped(p.chain)
    frame = Pose(rotation.exp(random.normal(size=3)), 0.2 * random.normal(size=3))
    placed = trunk_at_rest(p.chain, p.state)
    assert placed is not None and p.chain.trunk is not None
    last = len(p.chain.trunk.links) - 1
    base = placed.bodies[-1].frame.inverse() @ p.state.object_frame @ frame
    chain = replace(
        p.chain,
        arms={**p.chain.arms, "pin": Anchor(base)},
        grasps={**p.chain.grasps, "pin": grasp_of(kind, frame)},
        mounts={**p.chain.mounts, "pin": last if last >= 0 else "base"},
    )
    still = np.zeros((1, 6))
    inputs = replace(
        p.inputs,
        base_twists=np.concatenate([given.base_twists, still]),
        base_accelerations=np.concatenate([given.base_accelerations, still]),
    )
    return Problem(chain, project_velocity(chain, p.state, inputs=inputs), p.tau, inputs)


def by_anchor(seed: int) -> tuple[Problem, Problem]:
    """Return a chain of two arms, one of which holds rigidly, and the same with that one as trunk below an anchor."""
    p = random_problem(seed, arms=2, joints=7, grasps=("ball", "rigid"), moving_base=False)
    p = replace(p, state=project_velocity(p.chain, p.state), inputs=Inputs())
    name = p.chain.names[1]
    arm, part = p.chain.arms[name], p.chain.joints[name]
    order = np.r_[part.start : part.stop, : part.start]
    chain = replace(
        p.chain,
        arms={**p.chain.arms, name: Anchor(arm.tip)},
        trunk=Trunk(arm.joints, arm.links, arm.base),
        mounts={name: arm.joint_count - 1},
    )
    state = replace(p.state, q=p.state.q[order], qd=p.state.qd[order])
    return p, Problem(chain, state, p.tau[order], Inputs())
