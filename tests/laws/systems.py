"""Random systems with everything on, solved once."""

from __future__ import annotations

from functools import cache

from holdfast.dynamics import ForwardResult
from tests.systems.as_chain import Problem
from tests.systems.problems import random_problem

MIXED = {"grasps": ("rigid", "hinge", None, "softfinger", "ball"), "joints": (6, 7, 4, 8, 7), "moving_base": True}


@cache
def sample(seed: int) -> tuple[Problem, ForwardResult]:
    """Return one of many systems: 1 to 8 arms of 3 to 12 joints, any grasps, bases moving in two of three."""
    p = random_problem(seed, moving_base=seed % 3 > 0)
    return p, p.solved()


@cache
def mixed(seed: int) -> tuple[Problem, ForwardResult]:
    """Return five arms with every kind of grasp, one of them free, everything on."""
    p = random_problem(seed, **MIXED)
    return p, p.solved()
