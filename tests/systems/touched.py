"""Random chains with limits whose object touches walls of the world, at rest or sliding along them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from holdfast import Inputs
from holdfast.world import HalfSpace, Touching
from tests.systems.as_chain import Problem
from tests.systems.limited import limited_problem


def touched_problem(seed: int, *, most: int = 3, slides: bool | None = None) -> Problem:
    """Return a chain of `limited_problem` with one to three points of its object on walls of their own.

    If it slides, each wall contains the velocity of its point; else all is at rest.
    """
    random = np.random.default_rng([seed, 131])
    p = limited_problem(seed)
    slides = bool(random.random() < 0.5) if slides is None else slides
    state, inputs = (p.state, p.inputs) if slides else (p.state.at_rest(), Inputs(object_wrench=p.inputs.object_wrench))
    frame, twist = state.object_frame, state.object_twist
    size = np.mean([np.linalg.norm(grasp.frame.p) for grasp in p.chain.grasps.values()])
    points, walls = {}, {}
    for k in range(int(random.integers(1, most + 1))):
        arm = random.normal(size=3)
        arm *= size / np.linalg.norm(arm)
        place, v = frame.p + frame.R @ arm, twist[3:] + np.cross(twist[:3], frame.R @ arm)
        n = -frame.R @ arm + 0.3 * size * random.normal(size=3)
        if slides:
            n -= v * (n @ v) / (v @ v)
        n /= np.linalg.norm(n)
        points[f"p{k}"] = arm
        walls[f"wall{k}"] = HalfSpace(normal=n, offset=float(n @ place), friction=float(random.uniform(0.1, 0.5)))
    pairs = list(zip(points, walls, strict=True))
    return replace(p, chain=replace(p.chain, touching=Touching(points, walls, pairs)), state=state, inputs=inputs)
