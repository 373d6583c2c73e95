"""The times at which steps must end: the grid of a fixed step, breakpoints, events and the run's end.

At a breakpoint (where torques or inputs may jump) and at an event the run has two samples. The first is at the last
float64 before that time, at the end of a step to which the jump is unknown. The second is at the time itself, and no
step leads to it. When a grasp opens because it slips, the second sample is 1e-15 s after the first. The times of
samples therefore always increase, and both sides of a jump are recorded.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from holdfast.errors import ModelError
from holdfast.model import checks
from holdfast.spatial.scalar import Array

MOST_STEPS = 10_000_000
JUMP_WIDTH = 1e-15  # [s]: time between the two sides of a jump, unless float64 is coarser at that time
ALIKE = 1e-9  # grid times that are nearer to a breakpoint than this fraction of a step are omitted


class Stops(NamedTuple):
    """The times at which steps end, in order.

    Attributes:
        times: (stops,) [s].
        jumps: (stops,) whether a stop follows its predecessor by a jump instead of a step.
    """

    times: Array
    jumps: Array


def step_times(duration: float, step: float) -> Array:
    """Return the times of a grid of fixed steps [s]; the last is the duration.

    Raises:
        ModelError: the duration or the step is not positive, or there are too many steps.
    """
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


def just_after(t: float) -> float:
    """Return the time of the second side of a jump whose first side is at t [s]."""
    return max(t + JUMP_WIDTH, float(np.nextafter(t, np.inf)))


def stops(
    grid: Array, breakpoints: Sequence[float], events: Sequence[float], apart: float, ends: Sequence[float] = ()
) -> Stops:
    """Return the stops of a run from 0 to the grid's last time.

    Args:
        grid: (k,) times of the grid, beginning with 0 [s].
        breakpoints: times at which torques or inputs jump [s]; those outside the run or at its end are ignored.
        events: times of events, within the run [s].
        apart: grid times that are nearer than this to a jump, or to one of `ends`, are omitted [s].
        ends: further times at which steps end, without a jump [s].

    Raises:
        ModelError: a breakpoint is not finite.
    """
    given = checks.numbers(list(breakpoints), (len(breakpoints),), "simulation: breakpoints")
    at = np.unique([*given[(given > 0.0) & (given < grid[-1])], *events])
    own = np.setdiff1d([t for t in ends if 0.0 < t < grid[-1]], at)
    taken, steps = np.union1d(at, own), grid[1:]
    if len(taken):
        places = np.clip(np.searchsorted(taken, steps)[:, None] - [1, 0], 0, len(taken) - 1)
        nearest = np.abs(steps[:, None] - taken[places]).min(axis=1)
        steps = steps[(nearest > apart) | ((steps == grid[-1]) & (taken[-1] != grid[-1]))]
    steps = np.union1d(steps, own)
    times = np.concatenate([steps, np.nextafter(at, -np.inf), at])
    jumps = np.concatenate([np.zeros(len(steps) + len(at), dtype=bool), np.ones(len(at), dtype=bool)])
    order = np.lexsort([jumps, times])
    return Stops(times[order], jumps[order])
