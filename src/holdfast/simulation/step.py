"""One time step: Runge-Kutta, then back onto the grasps in position and velocity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from holdfast.dynamics.projection import FARTHEST, LEFT_OPEN, STEP_ROUNDS, after_step, largest_gaps, moved
from holdfast.errors import ClosureError, StateError
from holdfast.simulation.instant import Controller, Instant, evaluate
from holdfast.simulation.runge_kutta import Tableau, runge_kutta_step
from holdfast.simulation.world import World
from holdfast.spatial.scalar import Array
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


class Step(NamedTuple):
    """Where a step led.

    Attributes:
        instant: the chain then, closed again.
        gaps: what projection found and left.
        work: (4,) done during the step, see `balance.WORK_TERMS` [J].
        estimates: the scheme's estimates of the error in (dq, dqd, turn, dp, dV(C), work).
    """

    instant: Instant
    gaps: Gaps
    work: Array
    estimates: list[Array]


def take_step(
    world: World, controller: Controller, now: Instant, until: float, generic_rank: int, scheme: Tableau
) -> Step:
    """Return the chain one step later, at t = until, closed again.

    `now` is the first of the scheme's stages. The controller is asked at every stage; its
    memory moves on once a step, at the step's start.

    Args:
        world: the chain and what acts on it.
        controller: torques.
        now: the chain at the step's start, on the constraint.
        until: the step's end [s].
        generic_rank: rank of the constraint away from singular configurations.
        scheme: the Runge-Kutta scheme.

    Raises:
        SingularChainError: a stage is singular.
        ClosureError: the step left the constraint by more than a step may.
        StateError: a stage is not finite.
    """
    n = len(now.state.q)

    def derivative(t: float, y: Array) -> Array:
        there = displaced(now.state, _finite(y))
        stage = evaluate(world, controller, t, there, now.memory, generic_rank=generic_rank)
        return stage.rates(y[2 * n : 2 * n + 3])

    still = np.zeros(2 * n + 16)
    y, estimates = runge_kutta_step(derivative, now.t, still, until - now.t, scheme, first=now.rates(np.zeros(3)))
    state, gaps = back_on_constraint(world, until, displaced(now.state, _finite(y)))
    later = evaluate(world, controller, until, state, now.memory, generic_rank=generic_rank)
    return Step(later, gaps, y[2 * n + 12 :], estimates)


def displaced(state: State, y: Array) -> State:
    """Return the state moved by increments (dq, dqd, turn u, dp, dV(C), ...)."""
    n = len(state.q)
    there = moved(state, y[:n], y[2 * n : 2 * n + 6])
    return State(there.q, state.qd + y[n : 2 * n], there.object_pose, state.object_twist + y[2 * n + 6 : 2 * n + 12])


def back_on_constraint(world: World, t: float, state: State) -> tuple[State, Gaps]:
    """Return the state projected onto the grasps in the kinetic metric, and the gaps."""
    chain, inputs = world.at(t)
    given = inputs.shaped(chain)
    before = largest_gaps(chain, state, given)
    if not before.position <= FARTHEST:
        raise ClosureError(
            f"the grasps are open by {before.position:.3g} (m or rad), expected a step's rounding; try a smaller time"
            " step"
        )
    closed = after_step(chain, state, given)
    after = largest_gaps(chain, closed, given)
    if after.position > LEFT_OPEN:
        raise ClosureError(
            f"the grasps stay open by {after.position:.3g} (m or rad): {STEP_ROUNDS} rounds of Newton's method do not"
            " close them; try a smaller time step"
        )
    return closed, Gaps(np.array([before.position, after.position]), np.array([before.velocity, after.velocity]))


def _finite(y: Array) -> Array:
    if not np.isfinite(y).all():
        raise StateError("the step overflows float64; try a smaller time step")
    return y
