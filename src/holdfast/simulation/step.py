"""One time step: Runge-Kutta, then back onto the grasps in position and velocity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.dynamics.consistency import GraspResidual, closure, residuals
from holdfast.dynamics.projection import moved, project
from holdfast.simulation.instant import Controller, Instant, evaluate
from holdfast.simulation.rk4 import rk4_step
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


def take_step(
    world: World, controller: Controller, now: Instant, until: float, generic_rank: int
) -> tuple[Instant, Gaps, Array]:
    """Return the chain one step later, at t = until, closed again.

    `now` is the first of the four stages. The controller is asked at every stage; its
    memory moves on once a step, at the step's start.

    Args:
        world: the chain and what acts on it.
        controller: torques.
        now: the chain at the step's start, on the constraint.
        until: the step's end [s].
        generic_rank: rank of the constraint away from singular configurations.

    Returns:
        The chain then, the gaps that projection found and left, and the work done
        during the step, (4,) [J].

    Raises:
        SingularChainError: a stage is singular.
        ClosureError: the step left the constraint by more than a step may.
        StateError: a stage is not finite.
    """
    n = len(now.state.q)

    def derivative(t: float, y: Array) -> Array:
        stage = evaluate(world, controller, t, displaced(now.state, y), now.memory, generic_rank=generic_rank)
        return stage.rates(y[2 * n : 2 * n + 3])

    still = np.zeros(2 * n + 16)
    y = rk4_step(derivative, now.t, still, until - now.t, first=now.rates(np.zeros(3)))
    state, gaps = back_on_constraint(world, until, displaced(now.state, y))
    later = evaluate(world, controller, until, state, now.memory, generic_rank=generic_rank)
    return later, gaps, y[2 * n + 12 :]


def displaced(state: State, y: Array) -> State:
    """Return the state moved by increments (dq, dqd, turn u, dp, dV(C), ...)."""
    n = len(state.q)
    there = moved(state, y[:n], y[2 * n : 2 * n + 6])
    return State(there.q, state.qd + y[n : 2 * n], there.object_pose, state.object_twist + y[2 * n + 6 : 2 * n + 12])


def back_on_constraint(world: World, t: float, state: State) -> tuple[State, Gaps]:
    """Return the state projected onto the grasps in the kinetic metric, and the gaps."""
    chain, inputs = world.at(t)
    before = _largest(closure(chain, state, inputs))
    closed, motion = project(chain, state, inputs)
    after = _largest(residuals(motion, closed))
    return closed, Gaps(np.array([before[0], after[0]]), np.array([before[1], after[1]]))


def _largest(gaps: dict[str, GraspResidual]) -> tuple[float, float]:
    position = max((float(np.abs(gap.position).max(initial=0.0)) for gap in gaps.values()), default=0.0)
    velocity = max((float(np.abs(gap.velocity).max(initial=0.0)) for gap in gaps.values()), default=0.0)
    return position, velocity
