"""What takes steps: from the last accepted instant to later ones, each by a single step of the scheme.

Several ends may be asked for at once: the points inside a step at which contacts are verified are
reached by shortened steps from its start, not from an interpolant.

Steps that are too long for the motion are taken in parts. How far a step leaves the grasps open before projection is an
estimate of its error that costs nothing: of order p + 1 in the step h for a scheme of order p, it says how many
equal parts the step needs to stay below a limit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from holdfast.control.controller import Controller
from holdfast.errors import ClosureError, HoldfastError, ModelError, SingularChainError, StateError
from holdfast.simulation.adaptive import Tolerance
from holdfast.simulation.environment import Environment
from holdfast.simulation.instant import Instant, evaluate
from holdfast.simulation.linearly_implicit import Implicit
from holdfast.simulation.runge_kutta import RK4, Tableau
from holdfast.simulation.step import (
    Closing,
    Gaps,
    Question,
    Stage,
    StepCourse,
    answered,
    back_on_constraint,
    course_of,
    rows_held_near,
)
from holdfast.spatial.scalar import Array
from holdfast.state import State

NO_GAPS = Gaps(np.zeros(2), np.zeros(2))


@dataclass(frozen=True, eq=False)
class Advance:
    """Where one step led.

    Attributes:
        t: the step's end [s].
        instant: the chain then, closed again; None if the step failed.
        gaps: what projection found and left.
        work: (4,) done during the step, see `balance.WORK_TERMS` [J].
        error: estimated error of the step over the tolerance; 0 for a scheme that estimates none.
        failure: why there is no instant: SingularChainError, ClosureError or StateError.
    """

    t: float
    instant: Instant | None
    gaps: Gaps
    work: Array
    error: float = 0.0
    failure: HoldfastError | None = None


class Stepper(Protocol):
    """Takes steps of one chain in one environment under one controller."""

    @property
    def scheme(self) -> Tableau:
        """The Runge-Kutta scheme of its steps."""
        ...

    def start(self, t: float, state: State, memory: Any) -> tuple[Instant, Gaps]:
        """Return the chain at a given state, projected onto the grasps, and the gaps.

        Raises:
            SingularChainError: the configuration is singular.
            StateError: the state breaks a grasp, or the controller's torques do not fit.
        """
        ...

    def evaluate(self, t: float, state: State, memory: Any) -> Instant:
        """Return the chain at a given state taken as it is: to the bit what a step that ended there found.

        Raises:
            SingularChainError: the configuration is singular.
            StateError: the controller's torques do not fit.
        """
        ...

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return where one step from `now` to each of the end times leads; failures are in the answers."""
        ...


@dataclass(frozen=True, eq=False)
class ReferenceStepper:
    """Steps on floats, without machine code.

    Attributes:
        environment: the chain and what acts on it.
        controller: torques.
        generic_rank: rank of the constraint away from singular configurations.
        scheme: the Runge-Kutta scheme of the steps.
        tolerance: what `Advance.error` compares the scheme's estimates with.
    """

    environment: Environment
    controller: Controller
    generic_rank: int
    scheme: Tableau = RK4
    tolerance: Tolerance = field(default_factory=Tolerance)

    def start(self, t: float, state: State, memory: Any) -> tuple[Instant, Gaps]:
        """Return the chain at a given state; see `Stepper`."""
        held = rows_held_near(self.environment, t, state, self.generic_rank)
        state, gaps = back_on_constraint(self.environment, t, state, held)
        return self.evaluate(t, state, memory), gaps

    def evaluate(self, t: float, state: State, memory: Any) -> Instant:
        """Return the chain at a given state taken as it is; see `Stepper`."""
        return self._evaluated(t, state, memory, None)

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return where one step leads; see `Stepper`."""
        return [self._to(now, end) for end in ends]

    def _to(self, now: Instant, end: float) -> Advance:
        try:
            step = answered(self._course(now, end), lambda question: self._answer(question, now))
        except (SingularChainError, ClosureError, StateError) as cause:
            return Advance(end, None, NO_GAPS, np.zeros(4), failure=cause)
        except ModelError:  # the arm is sound: what its inertia is computed from has overflowed
            failure = StateError("the step overflows float64; try a smaller time step")
            return Advance(end, None, NO_GAPS, np.zeros(4), failure=failure)
        error = self.tolerance.ratio(step.estimates, now.state, step.later.state)
        return Advance(end, step.later, step.gaps, step.work, error)

    def _course(self, now: Instant, end: float) -> StepCourse:
        """Return the step, which asks for what it needs."""
        return course_of(now, end, self.scheme)

    def _answer(self, question: Question, now: Instant) -> Any:
        """Return what a step from `now` asks; the controller's memory moves on once a step, at the step's start."""
        held = now.result.held  # through the whole step
        if isinstance(question, Closing):
            return back_on_constraint(self.environment, question.t, question.state, held)
        if isinstance(question, Stage):
            at = self._evaluated(question.t, question.state, now.memory, held, question.implicit)
            return at.rates(question.turns)
        return self.evaluate(question.t, question.state, now.memory)

    def _evaluated(
        self, t: float, state: State, memory: Any, held: Array | None, implicit: Implicit | None = None
    ) -> Instant:
        of = self.environment, self.controller, t, state, memory
        return evaluate(*of, generic_rank=self.generic_rank, held=held, implicit=implicit)


MOST_PARTS = 32


@dataclass(frozen=True, eq=False)
class PartsStepper:
    """Takes steps in parts by another stepper; see `Stepper`. The controller's memory moves on once a step.

    Attributes:
        whole: takes the parts.
    """

    whole: Stepper

    @property
    def scheme(self) -> Tableau:
        """The Runge-Kutta scheme."""
        return self.whole.scheme

    def start(self, t: float, state: State, memory: Any) -> tuple[Instant, Gaps]:
        """Return the chain at a given state, projected onto the grasps; see `Stepper`."""
        return self.whole.start(t, state, memory)

    def evaluate(self, t: float, state: State, memory: Any) -> Instant:
        """Return the chain at a given state, taken as it is."""
        return self.whole.evaluate(t, state, memory)


@dataclass(frozen=True, eq=False)
class SubdividingStepper(PartsStepper):
    """Takes another stepper's steps, those whose drift passes a limit in equal parts; see `Stepper`.

    Attributes:
        limit: of the grasps' position gaps before projection, as far as parts can keep it [m or rad].
    """

    limit: float

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return where one step leads, in parts where it must be; see `Stepper`."""
        found = [(reached, self._parts(reached)) for reached in self.whole.advance(now, ends)]
        return [one if parts == 1 else in_parts(self.whole, now, one.t, parts) for one, parts in found]

    def _parts(self, reached: Advance) -> int:
        """Return how many parts a step needs."""
        if isinstance(reached.failure, ClosureError):
            return MOST_PARTS
        if reached.failure is not None:
            return 1
        return int(parts_needed(reached.gaps.position[0], self.limit, self.scheme.order))


def parts_needed(drift: ArrayLike, limit: float, order: int) -> Array:
    """Return into how many equal parts steps must go for less drift than a limit, of the drifts' shape.

    Args:
        drift: position gaps that whole steps left before projection [m or rad].
        limit: of the same.
        order: of the scheme.
    """
    with np.errstate(over="ignore"):  # of limits next to nothing
        times = np.asarray(drift) / limit
    return np.ceil(np.clip(times ** (1.0 / (order + 1)), 1, MOST_PARTS)).astype(int)


def in_parts(stepper: Stepper, now: Instant, until: float, parts: int) -> Advance:
    """Return where equal parts of a step lead; the controller's memory moves on once, as in a whole step.

    Args:
        stepper: takes the parts.
        now: the chain at the step's start.
        until: the step's end [s].
        parts: how many, at least one.
    """
    at, done = now, []
    for k in range(1, parts + 1):
        end = until if k == parts else now.t + k / parts * (until - now.t)
        (part,) = stepper.advance(at, [end])
        if part.instant is None:
            return replace(part, t=until)
        at = replace(part.instant, memory=now.memory)
        done.append(part)
    return together(done)


def together(parts: Sequence[Advance]) -> Advance:
    """Return parts of a step as one: the last one's end, the largest gaps, all the work."""
    gaps = [np.max([getattr(part.gaps, kind) for part in parts], axis=0) for kind in ("position", "velocity")]
    return replace(parts[-1], gaps=Gaps(*gaps), work=np.sum([part.work for part in parts], axis=0))
