"""Steps through a singular configuration: Gauss collocation, with every stage on the constraint.

Beside the grasps by d accelerations are off by d over the constraint's strength, so an explicit scheme, whose stages
lie beside them, loses its order about a singular configuration. The motion itself is smooth there. The polynomial that
has the right slope at Gauss's points, all of which are closed states, passes it to order 12, and no stage comes near a
singular configuration in the middle of the step (or at its ends).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from holdfast.errors import StateError
from holdfast.simulation.increment import body_parts, displaced, no_turns, turns_between, work_of
from holdfast.simulation.instant import Instant
from holdfast.simulation.runge_kutta import Tableau
from holdfast.simulation.step import Arrival, Closing, Stage, Step, StepCourse
from holdfast.simulation.stepper import ReferenceStepper

STAGES = 6
MOST_ROUNDS = 60
# By how much a round moves stages and their rates [rad, m, rad/s or m/s].
NEAR = 1e-3  # those that move by more are not closed yet
STILL = 1e-15  # rounding


@cache
def gauss() -> Tableau:
    """Return Gauss's implicit scheme of six stages, order 12."""
    nodes, weights = np.polynomial.legendre.leggauss(STAGES)
    c, b = 0.5 * (1.0 + nodes), 0.5 * weights
    powers = np.arange(STAGES)
    a = (c[:, None] ** (powers + 1) / (powers + 1)) @ np.linalg.inv(c[:, None] ** powers)
    return Tableau("gauss", 2 * STAGES, c, a, b, np.zeros((0, STAGES)))


def collocation_step(now: Instant, until: float) -> StepCourse:
    """Return the chain one step later, closed again; a course of questions as `take_step`.

    Args:
        now: the chain at the step's start.
        until: the step's end [s].

    Raises:
        StateError: the stages do not settle.
    """
    scheme, start, h, n = gauss(), now.state, until - now.t, len(now.state.q)
    times = [now.t + c * h for c in scheme.c.tolist()]
    slope = now.rates(no_turns(start))  # at first as if accelerations stayed
    slopes = np.tile(slope, (STAGES, 1))
    slopes[:, :n] += h * scheme.c[:, None] * slope[n : 2 * n]
    for part in body_parts(start):
        slopes[:, part.start : part.start + 6] += h * scheme.c[:, None] * slope[part.start + 6 : part.stop]
    before = moving = np.inf
    for _ in range(MOST_ROUNDS):
        increments = h * scheme.a @ slopes
        later = []
        for t, y in zip(times, increments, strict=True):
            state = displaced(start, y)
            if moving < NEAR:
                state, _ = yield Closing(t, state)
            later.append((yield Stage(t, state, turns_between(start, state))))
        found = np.array(later)
        before, moving = moving, float(h * np.abs(found - slopes)[:, : body_parts(start)[-1].stop].max())
        slopes = found
        if not np.isfinite(moving) or moving <= STILL or (moving < NEAR and moving >= 0.5 * before):
            break
    if not moving < NEAR:
        raise StateError("the stages of a step through a singular configuration do not settle; try a smaller step")
    y = h * scheme.b @ slopes
    closed, gaps = yield Closing(until, displaced(start, y))
    return Step((yield Arrival(until, closed)), gaps, work_of(y), [])


@dataclass(frozen=True, eq=False)
class CollocationStepper(ReferenceStepper):
    """Takes steps by collocation, on floats; see `Stepper`."""

    def _course(self, now: Instant, end: float) -> StepCourse:
        return collocation_step(now, end)
