"""Derivatives of a projection's rounds against five-point differences of the rounds themselves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from holdfast.dynamics.closed.chain_motion import chain_at_rest, chain_motion
from holdfast.dynamics.closed.forward_derivatives import backward, forward
from holdfast.dynamics.projection import closer, displaced_by, position_mismatch, project_velocities, quickened
from holdfast.dynamics.projection import moved as displaced
from holdfast.dynamics.projection_derivatives import (
    OF_MODEL,
    OF_POSITIONS,
    OF_VELOCITIES,
    change_of,
    impulse_point,
    round_point,
)
from holdfast.simulation.rollout.varied_step import state_arrays
from tests.derivatives.blocks import flat_direction, shape_of, size_of
from tests.derivatives.chains import TRUNKS, random_chain
from tests.derivatives.moved import moved_problem
from tests.longer import mostly_long
from tests.oracles.chain_derivatives import INERTIAS, names_of
from tests.systems.as_chain import Problem

OFF = 1e-2  # m, rad: how far beside the grasps
TOLERANCE = 1e-8
ROUNDS = {"position": round_point, "velocity": impulse_point}


def after(p: Problem, level: str) -> np.ndarray:
    """Return what one round makes of a problem's velocities or positions, as the steps take it."""
    inputs = p.inputs.shaped(p.chain)
    if level == "velocity":
        motion = chain_motion(p.chain, p.state, np.zeros(p.chain.joint_count), inputs)
        end, names = project_velocities(motion, p.state), ("qd", "object_twist", "floating_twist")
    else:
        motion = chain_at_rest(p.chain, p.state)
        end, names = closer(motion, p.state, position_mismatch(motion, p.state)), ("q",)
    return np.concatenate([x for name, x in state_arrays(p.chain, end).items() if name in names])


def moved(p: Problem, directions: dict[str, np.ndarray], far: float) -> Problem:
    """Return the problem along some directions."""
    at, along, first = {}, [], 0
    for name in names_of(p.chain):
        size = size_of(p, name)
        at[name] = slice(first, first + size)
        along.append(far * flat_direction(p, name, directions[name]) if name in directions else np.zeros(size))
        first += size
    return moved_problem(p, at, np.concatenate(along))


@pytest.mark.parametrize("level", ROUNDS)
@pytest.mark.parametrize(("seed", "trunk"), mostly_long([(s, t) for s in range(4) for t in TRUNKS], [(1, None)]))
def test_rounds(seed, trunk, level):
    """A round is the one that steps take, and changes with whatever it depends on as its derivatives say."""
    p, random = random_chain(seed, trunk), np.random.default_rng(seed)
    free = p.chain.velocity_count
    p = replace(p, state=displaced(p.state, OFF * random.normal(size=free)))
    n, of_state = p.chain.joint_count, (*OF_POSITIONS, *OF_VELOCITIES)
    at = ROUNDS[level](p.chain, p.state, p.inputs.shaped(p.chain), None, "auto")
    change = change_of(at)
    whole = quickened(p.state, change) if level == "velocity" else displaced_by(p.state, change)
    names = ("qd", "object_twist", "floating_twist") if level == "velocity" else ("q",)
    found = np.concatenate([x for name, x in state_arrays(p.chain, whole).items() if name in names])
    assert np.abs(found - after(p, level)).max() <= 1e-14 * np.abs(found).max()
    velocities = level == "velocity"
    of_model = set(OF_MODEL) - {"armature"}  # of which a joint may have none
    known = [x for x in names_of(p.chain) if x in of_model or (x in of_state and (velocities or x in OF_POSITIONS))]
    cotangents = {"qdd": random.normal(size=n)}
    if velocities:
        cotangents |= {"object_acceleration": random.normal(size=6)}
        cotangents |= {"floating_acceleration": random.normal(size=6)} if p.chain.floats else {}
    gradient, cotangent = backward(at, cotangents, known), np.concatenate([*cotangents.values()])
    own = {"q": "qdd", "qd": "qdd", "object_twist": "object_acceleration", "floating_twist": "floating_acceleration"}
    for name in known:
        direction = random.normal(size=shape_of(p, name))
        if name in INERTIAS:
            direction = direction + np.swapaxes(direction, -1, -2)
        if not direction.any():  # a chain without grasps that move
            continue
        by = {name: direction / np.abs(direction).max()}
        far = 1e-4 if name in (*INERTIAS, "object_mass") else 1e-3
        ends = [after(moved(p, by, k * far), level) @ cotangent for k in (1, -1, 2, -2)]
        expected = (8 * (ends[0] - ends[1]) - (ends[2] - ends[3])) / (12 * far)
        slope = float(np.sum(gradient[name] * by[name]))
        if name in own and (velocities or name == "q") and name in names:  # what is changed is itself varied
            slope += float(np.sum(cotangents[own[name]] * by[name]))
        size = max(abs(expected), 1e-3)
        assert abs(slope - expected) < TOLERANCE * max(size, 1.0), name
        pushed = forward(at, by)
        other_way = sum(np.sum(pushed[k] * x) for k, x in cotangents.items())
        assert abs(other_way - np.sum(gradient[name] * by[name])) < 1e-11 * max(1.0, size), name
