"""One time step: a Runge-Kutta step, followed by the projection of positions and velocities onto the grasps."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.closed.chain_motion import chain_at_rest
from holdfast.dynamics.consistency import largest_position
from holdfast.dynamics.projection import LEFT_OPEN, STEP_ROUNDS, WIDEST_GAP, after_step
from holdfast.dynamics.rank import held_near
from holdfast.errors import ClosureError, StateError
from holdfast.simulation.environment import Environment
from holdfast.simulation.increment import displaced, no_turns, turns_of, work_of
from holdfast.simulation.instant import Instant
from holdfast.simulation.linearly_implicit import Implicit, Passive, imex_step, passive_terms
from holdfast.simulation.runge_kutta import Tableau, runge_kutta_step
from holdfast.spatial.scalar import Array, Scalar
from holdfast.state import State


@dataclass(frozen=True, eq=False)
class Gaps:
    """The largest position and velocity gaps of any grasp, before and after projection.

    Attributes:
        position: (2,) before, after [m or rad].
        velocity: (2,) before, after [m/s or rad/s].
    """

    position: Array
    velocity: Array


class StageRequest(NamedTuple):
    """Request for the slope at a stage of the scheme, which is the time derivative of an `increment`.

    Attributes:
        t: time [s].
        state: the state at the stage, which violates the grasps slightly.
        turns: (3,) rotation vector u of each free body, with R = exp(u) R_0 relative to the step's start [rad].
        until: the step's end [s].
        implicit: additional armatures and torques of a linearly implicit scheme.
    """

    t: Scalar
    state: State
    turns: list[Array]
    until: Scalar
    implicit: Implicit | None = None


class ProjectionRequest(NamedTuple):
    """Request for the projection of a state onto the grasps, and for the gaps before and after it.

    Attributes:
        t: time [s].
        state: the state at the end of the Runge-Kutta step.
    """

    t: Scalar
    state: State


class EndRequest(NamedTuple):
    """Request for the full evaluation at the step's end.

    Attributes:
        t: time [s].
        state: the projected state.
    """

    t: Scalar
    state: State


EvaluationRequest = StageRequest | ProjectionRequest | EndRequest


class StepResult(NamedTuple):
    """The result of a step.

    Attributes:
        later: the reply to `EndRequest`.
        gaps: the gaps in the reply to `ProjectionRequest`.
        work: (4,) work done during the step, in the order of `balance.WORK_TERMS` [J].
        estimates: the scheme's estimates of the increment's error.
    """

    later: Any
    gaps: Any
    work: Array
    estimates: list[Array]


StepGenerator = Generator[EvaluationRequest, Any, StepResult]


def take_step(
    start: State, first: Array, h: Scalar, times: Sequence[Scalar], scheme: Tableau, passive: Passive | None = None
) -> StepGenerator:
    """Return the chain one step later, projected onto the grasps.

    This generator yields requests for evaluations of the chain. The caller replies with floats (`stepper`), with
    results of machine code for several end times at once (`rollout.compiled_steppers`), or with traced numbers
    (`rollout.traced_step`).

    Args:
        start: a state that satisfies the grasps, the first stage of the scheme.
        first: the slope at `start`.
        h: the step's length [s].
        times: times of the stages and of the step's end [s].
        scheme: the scheme.
        passive: damping, stiffness and friction that a linearly implicit scheme treats implicitly.

    Raises:
        StateError: a stage is not finite.
    """
    until = times[-1]

    def stage(i: int, y: Array | None, implicit: Implicit | None = None) -> StageRequest:
        if y is None:
            return StageRequest(times[i], start, no_turns(start), until, implicit)
        return StageRequest(times[i], displaced(start, _finite(y)), turns_of(start, y), until, implicit)

    if passive is None:
        y, estimates = yield from runge_kutta_step(first, h, scheme, stage)
    else:
        y, estimates = (yield from imex_step(start, passive, h, scheme, stage)), []
    closed, gaps = yield ProjectionRequest(until, displaced(start, _finite(y)))
    later = yield EndRequest(until, closed)
    return StepResult(later, gaps, work_of(y), estimates)


def step_generator(now: Instant, until: float, scheme: Tableau) -> StepGenerator:
    """Return the generator of a step from an instant to a time [s]."""
    h = until - now.t
    times = [*(now.t + c * h for c in scheme.c.tolist()), until]
    passive = passive_terms(now.chain) if scheme.implicit else None
    return take_step(now.state, now.rates(no_turns(now.state)), h, times, scheme, passive)


def run_step(generator: StepGenerator, evaluate: Callable[[EvaluationRequest], Any]) -> StepResult:
    """Return the result of a step whose requests are evaluated one by one."""
    (step,) = run_steps_together([generator], lambda requests: [evaluate(requests[0])])
    return step


def run_steps_together(
    generators: Sequence[StepGenerator], evaluate: Callable[[list[EvaluationRequest]], Sequence[Any]]
) -> list[StepResult]:
    """Return the results of several steps of one scheme, whose requests are evaluated together, stage by stage."""
    replies: Sequence[Any] = [None] * len(generators)
    while True:
        requests: list[EvaluationRequest] = []
        ends: list[StepResult] = []
        for generator, reply in zip(generators, replies, strict=True):
            try:
                requests.append(generator.send(reply))
            except StopIteration as end:
                ends.append(end.value)
        if not requests:
            return ends
        replies = evaluate(requests)


def back_on_constraint(
    environment: Environment, t: float, state: State, held: Array | None = None
) -> tuple[State, Gaps]:
    """Return the state projected onto the grasps, and the gaps before and after.

    Args:
        environment: the chain, its base motions and external inputs.
        t: time [s].
        state: a state that nearly satisfies the grasps.
        held: rows of the constraint to satisfy, see `held_rows`; None for all.

    Raises:
        ClosureError: the gaps are larger than a step may leave them, or the projection does not close them.
    """
    chain, inputs = environment.at(t, state)
    given = inputs.shaped(chain)
    closed, before, after, _ = after_step(chain, state, given, held)

    def open_by(at: State) -> float:
        return largest_position(chain_at_rest(chain, at), at)

    if not before.position <= WIDEST_GAP:
        raise ClosureError(
            f"the grasps are open by {open_by(state):.3g} (m or rad), expected a step's rounding; try a smaller time"
            " step"
        )
    if after.position > LEFT_OPEN:
        raise ClosureError(
            f"the grasps stay open by {open_by(closed):.3g} (m or rad): {STEP_ROUNDS} rounds of Newton's method do not"
            " close them; try a smaller time step"
        )
    return closed, Gaps(np.array([before.position, after.position]), np.array([before.velocity, after.velocity]))


def rows_held_near(environment: Environment, t: float, state: State, generic_rank: int) -> Array | None:
    """Return the rows of the constraint to satisfy near a state that violates the grasps slightly; see `held_rows`.

    They are chosen at the nearest closed state. The result is None if the rows are independent, or if no closed state
    is found.
    """
    return held_near(environment.chain_at(t), state, generic_rank)


def _finite(y: Array) -> Array:
    """Return an increment after checking that it is finite; traced numbers cannot be checked."""
    if y.dtype != object and not np.isfinite(y).all():
        raise StateError("the step overflows float64; try a smaller time step")
    return y
