"""Random chains whose grasps and drives have limits, most of which matter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from holdfast import ClosedChain, Friction, Grasp, Pose
from holdfast.dynamics import project_velocity
from holdfast.forces import ForceLimits, distribute
from holdfast.model.grasp import WrenchLimits
from holdfast.model.grasp_kinds import GRASP_KINDS
from holdfast.spatial import rotation
from tests.systems.as_chain import Problem, as_chain
from tests.systems.random_parts import rotation as random_rotation
from tests.systems.random_systems import random_system
from tests.systems.trunk_problems import on_trunk

KINDS = ("rigid", "hinge", "softfinger", "ball", "universal", "slider", "cylinder", "planar")
PRESSING = 0.8  # share of one-sided contacts among grasps that can be


def limited_problem(seed: int, *, trunks: bool = True) -> Problem:
    """Return a random chain of 2 to 6 arms with limits, in the world, on a trunk, or on a floating base, in motion.

    Torques of about the size that a squeeze needs are within the effort limits of most.
    """
    random = np.random.default_rng([seed, 41])
    count = int(random.integers(2, 7))
    joints = [int(n) for n in random.integers(6, 8, count)]
    p = as_chain(random_system(seed, joints=joints, grasps="rigid", moving_base=False, gravity=(0.0, 0.0, -9.81)))
    kinds = [str(random.choice(KINDS, p=[0.2, 0.15, 0.25, 0.2, 0.05, 0.05, 0.05, 0.05])) for _ in joints]
    p = regrasped(p, kinds, random)
    below = random.random()
    if trunks and below < 0.4:
        p = on_trunk(p, seed, int(random.integers(0, 4)) + (below < 0.2), floating=below >= 0.2)
    else:
        moved = replace(p.state, qd=p.state.qd + 0.2 * random.normal(size=len(p.state.qd)))
        p = replace(p, state=project_velocity(p.chain, moved, inputs=p.inputs))
    return replace(p, chain=with_effort_limits(p, random))


def regrasped(p: Problem, kinds: list[str], random: np.random.Generator) -> Problem:
    """Return a problem with other kinds of grasps at the same places, normals roughly into the object, with limits."""
    arms, grasps = dict(p.chain.arms), {}
    weight = 9.81 * p.chain.held_object.mass
    for (name, grasp), kind in zip(p.chain.grasps.items(), kinds, strict=True):
        into = -grasp.frame.p / np.linalg.norm(grasp.frame.p) + 0.2 * random.normal(size=3)
        R = rotation.exp(rotation.align(np.array([0.0, 0.0, 1.0]), into / np.linalg.norm(into)))
        frame = Pose(R @ rotation.exp(random.uniform(-3, 3) * np.array([0.0, 0.0, 1.0])), grasp.frame.p)
        arms[name] = arms[name].with_tip(arms[name].tip @ Pose(grasp.frame.R.T @ frame.R, np.zeros(3)))
        row = GRASP_KINDS[kind]
        if row.friction is not None and random.random() < PRESSING:
            size = {} if row.size is None else {row.size: float(random.uniform(0.005, 0.1))}
            grasps[name] = Grasp(kind, frame, Friction(float(random.uniform(0.4, 1.2)), **size))
        else:
            limits = WrenchLimits(float(random.uniform(0.1, 0.5) * weight), float(random.uniform(1, 4) * weight))
            grasps[name] = Grasp(kind, frame, wrench_limits=limits)
    return replace(p, chain=replace(p.chain, arms=arms, grasps=grasps))


def with_effort_limits(p: Problem, random: np.random.Generator) -> ClosedChain:
    """Return the chain with effort limits around the torques that hold its grasps without limits on torques."""
    held = distribute(p.chain, p.state, task=np.eye(6)[3:], inputs=p.inputs, limits=ForceLimits(effort=None))
    share = random.uniform(0.5, 3.0)
    sizes = (
        np.maximum(np.abs(held.tau), 0.15 * np.abs(held.tau).max()) * share * random.uniform(0.8, 1.5, len(held.tau))
    )
    limits = iter(sizes.tolist())

    def limited(part):
        return replace(part, joints=[replace(joint, effort_limit=next(limits)) for joint in part.joints])

    trunk = None if p.chain.trunk is None else limited(p.chain.trunk)
    return replace(p.chain, trunk=trunk, arms={name: limited(arm) for name, arm in p.chain.arms.items()})


def asked_of(seed: int) -> tuple[np.ndarray, np.ndarray | None]:
    """Return a random acceleration, of all six directions or of three."""
    random = np.random.default_rng([seed, 42])
    if random.random() < 0.3:
        return 2.0 * random.normal(size=3), random_rotation(random) @ np.eye(6)[3:]
    return 2.0 * random.normal(size=6), None
