"""Simulation of a closed chain under a controller, always on the constraint."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise

import numpy as np

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.instant import Controller, evaluate
from holdfast.simulation.stepper import ReferenceStepper
from holdfast.simulation.trajectory import Trajectory, sample, stacked
from holdfast.simulation.world import BaseMotion, World
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State

MOST_STEPS = 1_000_000


@np.errstate(all="ignore")  # a run that diverges ends in a StateError, not in warnings
def simulate(
    chain: ClosedChain,
    state: State,
    controller: Controller,
    duration: float,
    step: float,
    *,
    base_motion: Mapping[str, BaseMotion] | None = None,
    inputs: Inputs | Callable[[float], Inputs] | None = None,
    progress: Callable[[float], None] | None = None,
    on_sample: Callable[[Trajectory], None] | None = None,
) -> Trajectory:
    """Return the motion from a state, by fixed Runge-Kutta steps with projection.

    A step that turns singular, cannot be closed again or is not finite ends the run: what
    came before is returned, `stopped` says why and names the last good time.

    Args:
        chain: arms, object and grasps.
        state: where to start; must satisfy the grasps.
        controller: (t, state, memory) -> (torques (n,), memory), memory None at first.
        duration: [s].
        step: h [s]; the last step is shorter where h does not divide the duration.
        base_motion: t -> (pose, twist, acceleration) of moving bases, by arm name.
        inputs: external wrenches, constant or a function of t.
        progress: called with the time after every step.
        on_sample: called with every sample as it is made.

    Raises:
        ModelError: a duration or step that is not positive, or too many steps.
        StateError: the initial state breaks a grasp, or the controller's torques do not fit.
        SingularChainError: the initial configuration is singular.
    """
    times = step_times(duration, step)
    state.fits(chain)
    world = World(chain, base_motion or {}, Inputs() if inputs is None else inputs)
    # the start is judged with its neighbours; later a rank below its rank is a singularity
    generic = evaluate(world, controller, 0.0, state, None, check=True).result.rank
    stepper = ReferenceStepper(world, controller, generic)
    now, gaps = stepper.start(0.0, state, None)
    work = np.zeros(4)
    samples: list[Trajectory] = []

    def keep() -> None:
        samples.append(sample(now, gaps, work))
        if on_sample is not None:
            on_sample(samples[-1])

    keep()
    for begin, end in pairwise(times):
        (reached,) = stepper.advance(now, [float(end)])
        if reached.instant is None:
            return stacked(samples, f"stopped after t = {begin:.6g} s: {reached.failure}")
        now, gaps, work = reached.instant, reached.gaps, work + reached.work
        keep()
        if progress is not None:
            progress(float(end))
    return stacked(samples)


def step_times(duration: float, step: float) -> Array:
    """Return the times of all samples [s]; the last is the duration."""
    duration = checks.number(duration, "simulation: duration", above=0.0)
    step = checks.number(step, "simulation: step", above=0.0)
    if step > duration:
        raise ModelError(f"simulation: step: expected <= the duration {duration:g} s, got {step:g}")
    if duration / step > MOST_STEPS:
        raise ModelError(
            f"simulation: step: expected at most {MOST_STEPS} steps, got {duration / step:.3g}; try a larger step"
        )
    whole = int(np.floor(duration / step * (1 + 1e-12)))
    times = step * np.arange(whole + 1)
    if duration - times[-1] > 1e-9 * step:
        return np.append(times, duration)
    times[-1] = duration
    return times
