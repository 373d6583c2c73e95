"""Random chains for derivatives: every kind of grasp, driven bases, external wrenches, free arms, trunks."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from holdfast import HoldfastError, Pose
from holdfast.dynamics import Status
from holdfast.spatial import rotation
from tests.systems.as_chain import Problem
from tests.systems.problems import random_problem
from tests.systems.random_trunks import held_anyhow, settled, swaying
from tests.systems.trunk_problems import on_trunk

TRUNKS = (None, "fixed", "floating")
KINDS = ("rigid", "hinge", "softfinger", "ball")
LIMIT = 300.0  # the condition of a sound chain
TRIES = 40


@cache
def random_chain(seed: int, trunk: str | None = None, *, any_kind: bool = True, object_scale: float = 1.0) -> Problem:
    """Return a sound random chain whose forces are unique.

    It has 1 to 4 arms of 3 to 7 joints, the last of them sometimes free; bases move, drives have armature and damping,
    wrenches act on links and object.

    Args:
        seed: of the random numbers.
        trunk: what arms stand on, "fixed" or "floating"; None for bases of their own.
        any_kind: whether grasps slide and cross, too.
        object_scale: factor on the object's mass and inertia, judged without it.
    """
    for k in range(TRIES):
        try:
            p = _drawn(1000 * seed + k, trunk, any_kind)
            found = p.solved()
        except (HoldfastError, ValueError):
            continue
        full = found.rank == p.chain.constraint_row_count
        if full and found.status is Status.OK and found.condition < LIMIT:
            return scaled(p, object_scale)
    raise ValueError(f"none of {TRIES} chains is sound")


def scaled(p: Problem, scale: float) -> Problem:
    """Return the problem with another object's mass and inertia."""
    body = p.chain.held_object
    return replace(
        p, chain=replace(p.chain, held_object=replace(body, mass=scale * body.mass, inertia=scale * body.inertia))
    )


def _drawn(seed: int, trunk: str | None, any_kind: bool) -> Problem:
    random = np.random.default_rng([seed, 7])
    count = int(random.integers(1, 5))
    joints = random.integers(3, 8, count).tolist()
    grasps = [str(random.choice(KINDS)) for _ in range(count)]
    if count > 2 and random.random() < 0.3:
        grasps[-1] = None
    options = {"joints": tuple(joints), "grasps": tuple(grasps)}
    if trunk is None:
        p = random_problem(seed, **options, **({"moving_base": False} if any_kind else {}))
    else:
        own = random_problem(seed, **options, moving_base=False)
        p = on_trunk(own, seed, int(random.integers(1, 5)), floating=trunk == "floating")
    if any_kind:
        p = held_anyhow(p, random)
        return swaying(p, random) if random.random() < 0.5 else settled(p)
    return turned_contacts(p, random)


def turned_contacts(p: Problem, random: np.random.Generator) -> Problem:
    """Return the problem with contact frames turned as their kinds let them, tips alike: no axis lies along another's.

    Rigid, hinged, soft-fingered and ball grasps.
    """
    arms, grasps = dict(p.chain.arms), {}
    for name, grasp in p.chain.grasps.items():
        turn = random.normal(size=3)
        if grasp.kind in ("hinge", "softfinger"):
            turn = turn * {"hinge": [1.0, 0.0, 0.0], "softfinger": [0.0, 0.0, 1.0]}[grasp.kind]
        R = rotation.exp(turn)
        grasps[name] = replace(grasp, frame=Pose(grasp.frame.R @ R, grasp.frame.p))
        arms[name] = arms[name].with_tip(Pose(arms[name].tip.R @ R, arms[name].tip.p))
    return replace(p, chain=replace(p.chain, arms=arms, grasps=grasps))
