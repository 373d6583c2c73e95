"""Steppers, which take single steps of a scheme from the last accepted instant to one or several later times.

The points inside a step at which contacts are verified are reached by shorter steps from its start, not by an
interpolant; therefore several end times can be requested at once.

Steps that are too long for the motion are divided into parts. The gap that a step leaves at the grasps before
projection is an estimate of its error without extra cost. It is of order p + 1 in the step h for a scheme of order p,
from which follows how many equal parts keep it below a limit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from holdfast.control.controller import Controller
from holdfast.dynamics.closed.chain_motion import chain_at_rest
from holdfast.dynamics.constraint import dimensionless_rows
from holdfast.errors import ClosureError, HoldfastError, ModelError, SingularChainError, StateError
from holdfast.simulation.accounts import accounts_of
from holdfast.simulation.adaptive import Tolerance
from holdfast.simulation.environment import Environment
from holdfast.simulation.instant import Instant, evaluate
from holdfast.simulation.linearly_implicit import Implicit
from holdfast.simulation.runge_kutta import RK4, Tableau
from holdfast.simulation.step import (
    EvaluationRequest,
    Gaps,
    ProjectionRequest,
    StageRequest,
    StepResult,
    back_on_constraint,
    rows_held_near,
    run_step,
    step_generator,
)
from holdfast.spatial.scalar import Array
from holdfast.state import State

NO_GAPS = Gaps(np.zeros(2), np.zeros(2))
# function of times (k,) and arrays (k, ...) of as many instants, by the names of machine code, that returns what
# `accounts.accounts` does, (k, ...) each
Accounting = Callable[[Array, Mapping[str, Array]], dict[str, Array]]


@dataclass(frozen=True, eq=False)
class Advance:
    """The result of one step.

    Attributes:
        t: the step's end [s].
        instant: the instant at the end, projected onto the grasps; None if the step failed.
        gaps: position and velocity gaps before and after projection.
        work: (4,) work done during the step, in the order of `balance.WORK_TERMS` [J].
        error: estimated error of the step divided by the tolerance; 0 for a scheme without an estimate.
        failure: the error of a failed step (SingularChainError, ClosureError or StateError), otherwise None.
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
        """Return the chain at a given state projected onto the grasps, and the gaps before and after projection.

        Raises:
            SingularChainError: the configuration is singular.
            StateError: the state violates a grasp, or the controller's torques have a wrong shape or are not finite.
        """
        ...

    def evaluate(self, t: float, state: State, memory: Any) -> Instant:
        """Return the chain at a given state without projection, identical in all bits to a step that ends there.

        Raises:
            SingularChainError: the configuration is singular.
            StateError: the controller's torques have a wrong shape or are not finite.
        """
        ...

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return the result of one step from `now` to each of the end times; failures are part of the results."""
        ...

    def replies(self, now: Instant, requests: Sequence[EvaluationRequest]) -> list[Any]:
        """Return the replies to requests of one kind, made by steps from `now`; see `step.take_step`.

        Raises:
            HoldfastError: the chain cannot be evaluated or projected there.
        """
        ...

    def constraint(self, times: Sequence[float], states: Sequence[State]) -> Array:
        """Return the rows of the constraint at several states, (k, rows, n + 6); see `constraint.dimensionless_rows`.

        Args:
            times: (k,) times, for the poses of moving bases [s].
            states: positions; velocities are ignored.
        """
        ...

    def accounts(self, t: Array, arrays: Mapping[str, Array]) -> dict[str, Array]:
        """Return what a run records besides the motion; see `Accounting`."""
        ...


@dataclass(frozen=True, eq=False)
class ReferenceStepper:
    """Takes steps on floats, without machine code.

    Attributes:
        environment: the chain, its base motions and external inputs.
        controller: the controller that returns the torques.
        generic_rank: rank of the constraint away from singular configurations.
        scheme: the Runge-Kutta scheme of the steps.
        tolerance: the tolerance by which the estimated errors are divided to give `Advance.error`.
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
        """Return the chain at a given state without projection; see `Stepper`."""
        return self._evaluated(t, state, memory, None)

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return the results of single steps; see `Stepper`."""
        return [self._to(now, end) for end in ends]

    def constraint(self, times: Sequence[float], states: Sequence[State]) -> Array:
        """Return the rows of the constraint; see `Stepper`."""
        at = [chain_at_rest(self.environment.chain_at(t), state) for t, state in zip(times, states, strict=True)]
        return np.array([dimensionless_rows(motion) for motion in at])

    def accounts(self, t: Array, arrays: Mapping[str, Array]) -> dict[str, Array]:
        """Return what a run records besides the motion; see `Accounting`."""
        return accounts_of(self.environment, t, arrays)

    def _to(self, now: Instant, end: float) -> Advance:
        generator = step_generator(now, end, self.scheme)
        reached, step = attempted(end, lambda: run_step(generator, lambda request: self._reply(request, now)))
        if step is None:
            return reached
        return replace(reached, error=self.tolerance.ratio(step.estimates, now.state, step.later.state))

    def replies(self, now: Instant, requests: Sequence[EvaluationRequest]) -> list[Any]:
        """Return the replies to requests; see `Stepper`."""
        return [self._reply(request, now) for request in requests]

    def _reply(self, request: EvaluationRequest, now: Instant) -> Any:
        """Return the reply to a request of a step from `now`.

        The controller's memory is updated once per step, at its start.
        """
        held = now.result.held  # the same rows during the whole step
        if isinstance(request, ProjectionRequest):
            return back_on_constraint(self.environment, request.t, request.state, held)
        if isinstance(request, StageRequest):
            at = self._evaluated(request.t, request.state, now.memory, held, request.implicit)
            return at.rates(request.turns)
        return self.evaluate(request.t, request.state, now.memory)

    def _evaluated(
        self, t: float, state: State, memory: Any, held: Array | None, implicit: Implicit | None = None
    ) -> Instant:
        of = self.environment, self.controller, t, state, memory
        return evaluate(*of, generic_rank=self.generic_rank, held=held, implicit=implicit)


def attempted(end: float, take: Callable[[], StepResult]) -> tuple[Advance, StepResult | None]:
    """Return the result of a step to a time [s] that a function takes; the second is None if it has failed."""
    try:
        step = take()
    except (SingularChainError, ClosureError, StateError) as cause:
        return Advance(end, None, NO_GAPS, np.zeros(4), failure=cause), None
    except ModelError:  # the model is valid: the state from which the inertia is computed has overflowed
        failure = StateError("the step overflows float64; try a smaller time step")
        return Advance(end, None, NO_GAPS, np.zeros(4), failure=failure), None
    return Advance(end, step.later, step.gaps, step.work), step


MOST_SUBSTEPS = 32


@dataclass(frozen=True, eq=False)
class PartsStepper:
    """Takes steps in parts with another stepper; see `Stepper`. The controller's memory is updated once per step.

    Attributes:
        whole: the stepper that takes the parts.
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
        """Return the chain at a given state without projection."""
        return self.whole.evaluate(t, state, memory)

    def replies(self, now: Instant, requests: Sequence[EvaluationRequest]) -> list[Any]:
        """Return the replies to requests; see `Stepper`."""
        return self.whole.replies(now, requests)

    def constraint(self, times: Sequence[float], states: Sequence[State]) -> Array:
        """Return the rows of the constraint; see `Stepper`."""
        return self.whole.constraint(times, states)

    def accounts(self, t: Array, arrays: Mapping[str, Array]) -> dict[str, Array]:
        """Return what a run records besides the motion; see `Accounting`."""
        return self.whole.accounts(t, arrays)


@dataclass(frozen=True, eq=False)
class SubdividingStepper(PartsStepper):
    """Takes the steps of another stepper, in equal parts if the drift of a step exceeds a limit; see `Stepper`.

    Attributes:
        limit: greatest position gap of the grasps before projection, as far as `MOST_SUBSTEPS` allow it [m or rad].
    """

    limit: float

    def advance(self, now: Instant, ends: Sequence[float]) -> list[Advance]:
        """Return the results of single steps, taken in parts where necessary; see `Stepper`."""
        found = [(reached, self._parts(reached)) for reached in self.whole.advance(now, ends)]
        return [one if parts == 1 else in_parts(self.whole, now, one.t, parts) for one, parts in found]

    def _parts(self, reached: Advance) -> int:
        """Return the number of parts into which a step has to be divided."""
        if isinstance(reached.failure, ClosureError):
            return MOST_SUBSTEPS
        if reached.failure is not None:
            return 1
        return int(parts_needed(reached.gaps.position[0], self.limit, self.scheme.order))


def parts_needed(drift: ArrayLike, limit: float, order: int) -> Array:
    """Return the numbers of equal parts that keep the drifts of steps below a limit, in the shape of `drift`.

    Args:
        drift: position gaps of whole steps before projection [m or rad].
        limit: greatest accepted position gap [m or rad].
        order: order of the scheme.
    """
    with np.errstate(over="ignore"):  # of limits next to nothing
        times = np.asarray(drift) / limit
    return np.ceil(np.clip(times ** (1.0 / (order + 1)), 1, MOST_SUBSTEPS)).astype(int)


def in_parts(stepper: Stepper, now: Instant, until: float, parts: int) -> Advance:
    """Return the result of a step taken in equal parts; the controller's memory is updated once, as in a whole step.

    Args:
        stepper: the stepper that takes the parts.
        now: the chain at the step's start.
        until: the step's end [s].
        parts: the number of parts, at least one.
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
    """Return the results of a step's parts as one: the end of the last part, the largest gaps, and the total work."""
    gaps = [np.max([getattr(part.gaps, kind) for part in parts], axis=0) for kind in ("position", "velocity")]
    return replace(parts[-1], gaps=Gaps(*gaps), work=np.sum([part.work for part in parts], axis=0))
