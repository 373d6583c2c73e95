"""Whether a traced step passes a singular configuration."""

from __future__ import annotations

from dataclasses import replace
from functools import reduce
from typing import TYPE_CHECKING

import numpy as np

from holdfast.dynamics.near_singular import STRENGTH_LOST
from holdfast.dynamics.projection import Gap
from holdfast.simulation.increment import twists
from holdfast.simulation.runge_kutta import Tableau
from holdfast.spatial import rotation
from holdfast.spatial.scalar import Array, Scalar, concatenate, maximum, minimum, reciprocal, sqrt, where
from holdfast.state import State

if TYPE_CHECKING:
    from holdfast.simulation.rollout.traced_step import TracedSystem

BESIDE = 0.1  # share of the strengths at both ends; a smaller difference may be due to curvature
LEAPING = 1e-3  # drift relative to the motion of the joints


def passes_singular(system: TracedSystem, tableau: Tableau, end: State, drift: Gap) -> Scalar:
    """Return 1 if a step probably passes a singular configuration, otherwise 0.

    The strength s = condition^-1/2 of the constraint is the absolute value of a quantity that changes sign at a
    singular configuration. If a step passes one, the strengths at its start, middle and end therefore lie on a straight
    line, up to the curvature of the step, once the last or the last two are taken with the opposite sign. In addition,
    their sum is not larger than the motion of the joints can explain. A step that begins or ends within a twentieth of
    its length from the configuration counts as passing it. So does a step near the configuration whose gaps before
    projection are so large that it may have leapt across.

    Args:
        system: the system after all evaluations of the step.
        tableau: the scheme.
        end: the state at the step's end.
        drift: gaps before projection.
    """
    nodes, found = [*tableau.c[1:].tolist(), 1.0], system.conditions
    if tableau.implicit:
        later = _between(system, end), found[-1]
    elif 0.5 in nodes:
        later = found[nodes.index(0.5)], found[nodes.index(1.0)]
    else:
        return 0.0
    first, middle, last = (reciprocal(sqrt(x)) for x in (system.last("condition")[()], *later))
    kept_sign = abs(first - 2.0 * middle + last)
    other_sign = minimum(abs(first + 2.0 * middle - last), abs(first - 2.0 * middle - last))
    turned = [system.given["step"][()] * twist[:3] for twist in twists(end)]
    moved = [*(end.q - system.last("q")), *concatenate(turned)]
    far = reduce(maximum, [abs(x) for x in moved])
    if any(not joint.turns for joint in system.real.all_joints):
        far = float("inf")  # the displacement of a sliding joint has no scale of its own
    both, most = first + last, STRENGTH_LOST * far
    passed = where(both < most, where(other_sign - BESIDE * both < kept_sign, 1.0, 0.0), 0.0)
    leaping = where(both < 2.0 * most, where(drift.position > LEAPING * far, 1.0, 0.0), 0.0)
    return maximum(passed, leaping)


def _between(system: TracedSystem, end: State) -> Scalar:
    """Return the condition half-way through an implicit step, whose own stages have larger armatures."""
    begin = system.state
    poses = [name for name in ("object_pose", "base_pose") if getattr(end, name) is not None]
    there = {name: _halfway(getattr(begin, name), getattr(end, name)) for name in poses}
    state = replace(end, q=0.5 * (begin.q + end.q), **there)
    chain, inputs = system.environment.at(system.time(0.5), state)
    return system.solve(chain, state, np.zeros(len(end.q)), inputs, system.held, choose=False).condition


def _halfway(a: Array, b: Array) -> Array:
    """Return the pose half-way between two poses that are close to each other, (7,)."""
    return concatenate([rotation.quaternion_midpoint(a[:4], b[:4]), 0.5 * (a[4:] + b[4:])])
