"""One time step: Runge-Kutta, then back onto the grasps in position and velocity."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.projection import FARTHEST, LEFT_OPEN, STEP_ROUNDS, after_step, largest_gaps
from holdfast.dynamics.rank import held_near
from holdfast.errors import ClosureError, StateError
from holdfast.simulation.environment import Environment
from holdfast.simulation.increment import displaced, no_turns, turns_of, work_of
from holdfast.simulation.instant import Instant, passive_at
from holdfast.simulation.linearly_implicit import Implicit, Passive, imex_step
from holdfast.simulation.runge_kutta import Tableau, runge_kutta_step
from holdfast.spatial.scalar import Array, Scalar
from holdfast.state import State


@dataclass(frozen=True, eq=False)
class Gaps:
    """How far the worst grasp is from holding, before and after projection.

    Attributes:
        position: (2,) before, after [m or rad].
        velocity: (2,) before, after [m/s or rad/s].
    """

    position: Array
    velocity: Array


class Stage(NamedTuple):
    """Asks for the slope at a stage of the scheme, d/dt of an `increment`.

    Attributes:
        t: time [s].
        state: the chain there, a little off the grasps.
        turns: (3,) u of each free body, where exp(u) has brought it there since the step's start [rad].
        implicit: what forward dynamics differs by, of a linearly implicit scheme.
    """

    t: Scalar
    state: State
    turns: list[Array]
    implicit: Implicit | None = None


class Closing(NamedTuple):
    """Asks for the state closed again, and for the gaps before and after.

    Attributes:
        t: time [s].
        state: where the scheme ends.
    """

    t: Scalar
    state: State


class Arrival(NamedTuple):
    """Asks for everything at the step's end.

    Attributes:
        t: time [s].
        state: the chain there, closed again.
    """

    t: Scalar
    state: State


Question = Stage | Closing | Arrival


class Step(NamedTuple):
    """Where a step led.

    Attributes:
        later: what was answered at its end.
        gaps: what projection found and left, as answered.
        work: (4,) done during the step, see `balance.WORK_TERMS` [J].
        estimates: the scheme's estimates of the increment's error.
    """

    later: Any
    gaps: Any
    work: Array
    estimates: list[Array]


StepCourse = Generator[Question, Any, Step]


def take_step(
    start: State, first: Array, h: Scalar, times: Sequence[Scalar], scheme: Tableau, passive: Passive | None = None
) -> StepCourse:
    """Return the chain one step later, closed again.

    A generator, which asks how the chain is found at a state: on floats (`stepper`), for several ends side
    by side by machine code (`rollout.compiled_steppers`), or traced (`rollout.traced_step`).

    Args:
        start: on the constraint; the first of the scheme's stages.
        first: the slope there.
        h: the step's length [s].
        times: of the stages, and of the end [s].
        scheme: the scheme.
        passive: what a linearly implicit scheme takes implicitly.

    Raises:
        StateError: a stage is not finite.
    """
    until = times[-1]

    def stage(i: int, y: Array | None, implicit: Implicit | None = None) -> Stage:
        if y is None:
            return Stage(times[i], start, no_turns(start), implicit)
        return Stage(times[i], displaced(start, _finite(y)), turns_of(start, y), implicit)

    if passive is None:
        y, estimates = yield from runge_kutta_step(first, h, scheme, stage)
    else:
        y, estimates = (yield from imex_step(start, passive, h, scheme, stage)), []
    closed, gaps = yield Closing(until, displaced(start, _finite(y)))
    later = yield Arrival(until, closed)
    return Step(later, gaps, work_of(y), estimates)


def course_of(now: Instant, until: float, scheme: Tableau) -> StepCourse:
    """Return a step from an instant to a time [s]."""
    h = until - now.t
    times = [*(now.t + c * h for c in scheme.c.tolist()), until]
    passive = passive_at(now.chain, now.state.qd) if scheme.implicit else None
    return take_step(now.state, now.rates(no_turns(now.state)), h, times, scheme, passive)


def answered(course: StepCourse, answer: Callable[[Question], Any]) -> Step:
    """Return what a step leads to."""
    (step,) = answered_together([course], lambda questions: [answer(questions[0])])
    return step


def answered_together(courses: Sequence[StepCourse], answer: Callable[[list[Question]], Sequence[Any]]) -> list[Step]:
    """Return what steps of one scheme lead to, the same question of all of them answered at once."""
    replies: Sequence[Any] = [None] * len(courses)
    while True:
        questions: list[Question] = []
        ends: list[Step] = []
        for course, reply in zip(courses, replies, strict=True):
            try:
                questions.append(course.send(reply))
            except StopIteration as end:
                ends.append(end.value)
        if not questions:
            return ends
        replies = answer(questions)


def back_on_constraint(
    environment: Environment, t: float, state: State, held: Array | None = None
) -> tuple[State, Gaps]:
    """Return the state projected onto the grasps, and the gaps.

    Args:
        environment: the chain and what acts on it.
        t: time [s].
        state: near the grasps.
        held: which components of the grasps are held, see `held_rows`; None: all.

    Raises:
        ClosureError: they are open by more than a step may leave them, or stay so.
    """
    chain, inputs = environment.at(t, state)
    given = inputs.shaped(chain)
    before = largest_gaps(chain, state, given)
    if not before.position <= FARTHEST:
        raise ClosureError(
            f"the grasps are open by {before.position:.3g} (m or rad), expected a step's rounding; try a smaller time"
            " step"
        )
    closed = after_step(chain, state, given, held)
    after = largest_gaps(chain, closed, given)
    if after.position > LEFT_OPEN:
        raise ClosureError(
            f"the grasps stay open by {after.position:.3g} (m or rad): {STEP_ROUNDS} rounds of Newton's method do not"
            " close them; try a smaller time step"
        )
    return closed, Gaps(np.array([before.position, after.position]), np.array([before.velocity, after.velocity]))


def rows_held_near(environment: Environment, t: float, state: State, generic_rank: int) -> Array | None:
    """Return which components of the grasps to hold at a state a little off them; see `held_rows`.

    They are chosen at the nearest closed state. None where no row follows from others, or nothing closes the grasps.
    """
    return held_near(environment.chain_at(t), state, generic_rank)


def _finite(y: Array) -> Array:
    """Return an increment, refused if it is not finite; of a traced one nothing is known yet."""
    if y.dtype != object and not np.isfinite(y).all():
        raise StateError("the step overflows float64; try a smaller time step")
    return y
