"""Steps through a singular configuration by Gauss collocation, with every stage on the constraint.

At a state that violates the grasps by d, the accelerations are wrong by d divided by the strength of the constraint.
The stages of an explicit scheme violate the grasps slightly, so the scheme loses its order near a singular
configuration. The motion itself is smooth there. Collocation determines the polynomial whose slope is right at the
Gauss points, all of which are closed states. It has order 12, and none of its stages is near a singular configuration
that lies in the middle of the step (or at its ends).
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from functools import cache
from typing import Any

import numpy as np

from holdfast.errors import StateError
from holdfast.simulation.increment import body_parts, displaced, no_turns, turns_between, work_of
from holdfast.simulation.instant import Instant
from holdfast.simulation.runge_kutta import Tableau
from holdfast.simulation.step import EndRequest, EvaluationRequest, ProjectionRequest, StageRequest, StepResult
from holdfast.simulation.stepper import Advance, PartsStepper, attempted

STAGES = 6
MOST_ITERATIONS = 60
# Limits of the change of the stages and their rates in one iteration [rad, m, rad/s or m/s].
NEARLY_CONVERGED = 1e-3  # stages that change by more are not projected onto the grasps yet
CONVERGED = 1e-15  # rounding: the iteration has converged


@cache
def gauss() -> Tableau:
    """Return the Gauss method with six stages, an implicit scheme of order 12."""
    nodes, weights = np.polynomial.legendre.leggauss(STAGES)
    c, b = 0.5 * (1.0 + nodes), 0.5 * weights
    powers = np.arange(STAGES)
    a = (c[:, None] ** (powers + 1) / (powers + 1)) @ np.linalg.inv(c[:, None] ** powers)
    return Tableau("gauss", 2 * STAGES, c, a, b, np.zeros((0, STAGES)))


def collocation_step(now: Instant, until: float) -> Generator[Sequence[EvaluationRequest], list[Any], StepResult]:
    """Return the chain one step later, projected onto the grasps; a generator of requests, several at a time.

    Args:
        now: the chain at the step's start.
        until: the step's end [s].

    Raises:
        StateError: the iteration for the stages does not converge.
    """
    scheme, start, h, n = gauss(), now.state, until - now.t, len(now.state.q)
    times = [now.t + c * h for c in scheme.c.tolist()]
    slope = now.rates(no_turns(start))  # first guess: constant accelerations
    slopes = np.tile(slope, (STAGES, 1))
    slopes[:, :n] += h * scheme.c[:, None] * slope[n : 2 * n]
    for part in body_parts(start):
        slopes[:, part.start : part.start + 6] += h * scheme.c[:, None] * slope[part.start + 6 : part.stop]
    before = moving = np.inf
    for _ in range(MOST_ITERATIONS):
        increments = h * scheme.a @ slopes
        states = [displaced(start, y) for y in increments]
        if moving < NEARLY_CONVERGED:
            closed = yield [ProjectionRequest(t, state) for t, state in zip(times, states, strict=True)]
            states = [state for state, _ in closed]
        turns = [turns_between(start, state) for state in states]
        stages = [StageRequest(*one, until) for one in zip(times, states, turns, strict=True)]
        found = np.array((yield stages))
        before, moving = moving, float(h * np.abs(found - slopes)[:, : body_parts(start)[-1].stop].max())
        slopes = found
        if not np.isfinite(moving) or moving <= CONVERGED or (moving < NEARLY_CONVERGED and moving >= 0.5 * before):
            break
    if not moving < NEARLY_CONVERGED:
        raise StateError("the stages of a step through a singular configuration do not settle; try a smaller step")
    y = h * scheme.b @ slopes
    ((end, gaps),) = yield [ProjectionRequest(until, displaced(start, y))]
    (later,) = yield [EndRequest(until, end)]
    return StepResult(later, gaps, work_of(y), [])


class CollocationStepper(PartsStepper):
    """Takes steps by collocation, with the evaluations of another stepper; see `Stepper`."""

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return the results of single steps; see `Stepper`."""
        return [attempted(end, lambda end=end: self._step(now, end))[0] for end in ends]

    def _step(self, now: Instant, end: float) -> StepResult:
        generator, replies = collocation_step(now, end), None
        while True:
            try:
                requests = next(generator) if replies is None else generator.send(replies)
            except StopIteration as done:
                return done.value
            replies = self.whole.replies(now, requests)
