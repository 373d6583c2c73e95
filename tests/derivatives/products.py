"""What forward dynamics' derivatives are compared with, by several tests."""

from __future__ import annotations

from typing import Any

import numpy as np

from holdfast import State
from tests.derivatives.blocks import NAMES, as_direction, flat_gradient, given, shapes, size_of
from tests.derivatives.stored import gaps
from tests.oracles.chain_derivatives import INERTIAS, OUTPUTS, SYMMETRIC, Derivatives
from tests.systems.as_chain import Problem
from tests.systems.problems import relative_gap

RANDOM = 1e-10
ROUNDING = 1e-13  # of a group's largest entry: blocks that are zero


def worst_gap(found, expected: Derivatives, names, nothing: float = ROUNDING) -> float:
    """Return the worst gap of all blocks from the oracle's."""
    worst = 0.0
    for by in names:
        wanted = {of: expected.block(of, by) for of in OUTPUTS}
        off = dict(gaps({of: found[of, by] for of in OUTPUTS}, wanted, nothing))
        assert max(off.values()) < RANDOM, (by, off)
        worst = max(worst, *off.values())
    return worst


def random_cotangents(p: Problem, random: np.random.Generator) -> dict[str, np.ndarray]:
    """Return a cotangent of every output."""
    return {name: random.normal(size=shape) for name, shape in shapes(p).items()}


def random_directions(p: Problem, random: np.random.Generator, by=NAMES) -> dict[str, np.ndarray]:
    """Return a direction of every argument and parameter."""
    return {name: as_direction(p, name, random.normal(size=size_of(p, name))) for name in by}


def worst_of_products(way: Any, p: Problem, expected: Derivatives, random: np.random.Generator, by=NAMES) -> float:
    """Return how far a gradient of random cotangents and rates along random directions are from the oracle's.

    Args:
        way: machine code, or the reference.
        p: the problem.
        expected: the oracle's matrices.
        random: where cotangents and directions come from.
        by: the arguments.
    """
    cotangents, along = random_cotangents(p, random), random_directions(p, random, by)
    pulled = way.forward_dynamics_vjp(**given(p), **cotangents, by=by)
    pushed = way.forward_dynamics_jvp(**given(p), along=along)
    worst = 0.0
    for name in by:
        parts = [np.ravel(cotangents[of]) @ expected.block(of, name) for of in OUTPUTS]
        size = max(np.abs(x).max(initial=0.0) for x in parts)
        off = np.abs(flat_gradient(p, name, getattr(pulled, name)) - sum(parts)).max(initial=0.0)
        worst = max(worst, off / (size or 1.0))
    flat = {name: flat_direction(p, name, along[name]) for name in by}
    for of in OUTPUTS:
        parts = [expected.block(of, name) @ flat[name] for name in by]
        worst = max(worst, relative_gap(np.ravel(getattr(pushed, of)), sum(parts)))
    return worst


def state_of(system: dict[str, np.ndarray]) -> State:
    """Return the state of a system."""
    return State(*(system[name] for name in ("q", "qd", "object_pose", "object_twist")))


def flat_direction(p: Problem, by: str, direction: np.ndarray) -> np.ndarray:
    """Return a direction as `as_direction` takes it; inertias as six numbers."""
    if by in INERTIAS:
        entries = np.reshape(direction, (-1, 3, 3))
        return np.array([x[i, j] for x in entries for i, j in SYMMETRIC])
    return np.ravel(direction)
