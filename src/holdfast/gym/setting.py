"""Checks of the attributes of tasks."""

from __future__ import annotations

from typing import Any

import numpy as np

from holdfast.errors import ModelError
from holdfast.forces.margins import joint_limits
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.frozen import read_only
from holdfast.spatial.scalar import Array

TENTH = 0.1  # default torque at an action of 1, as a fraction of the effort limit
UNLIMITED = 10.0  # N m or N: default torque at an action of 1 without an effort limit


def common_setting(task: Any, what: str) -> None:
    """Check and convert in place the attributes that all tasks have.

    Raises:
        ModelError: an attribute is invalid; the message names it.
    """
    put = object.__setattr__
    for name in ("step", "tolerance", "tolerance_angle"):
        put(task, name, positive(task, name, what))
    for name in ("effort_cost", "failure_cost"):
        put(task, name, not_negative(task, name, what))
    steps = task.steps_per_action
    if isinstance(steps, bool) or not isinstance(steps, int | np.integer) or steps < 1:
        raise ModelError(f"{what}: steps_per_action: expected an integer >= 1, got {checks.short(steps)}")
    put(task, "mass_spread", not_negative(task, "mass_spread", what))
    if task.mass_spread >= 1.0:
        raise ModelError(f"{what}: mass_spread: expected less than 1, as masses are positive, got {task.mass_spread:g}")
    put(task, "push", spread(task.push, 6, f"{what}: push"))
    checks.instance(task.stop_at_limits, (bool, np.bool_), f"{what}: stop_at_limits")


def positive(task: Any, name: str, what: str) -> float:
    """Return an attribute of a task, which must be a positive number."""
    return checks.number(getattr(task, name), f"{what}: {name}", above=0.0)


def not_negative(task: Any, name: str, what: str) -> float:
    """Return an attribute of a task, which must be a number >= 0."""
    return checks.number(getattr(task, name), f"{what}: {name}", at_least=0.0)


def spread(value: Any, count: int, what: str) -> Array:
    """Return largest deviations from a mean, (count,), none of which may be negative."""
    x = checks.numbers(value, (count,), what)
    if (x < 0.0).any():
        raise ModelError(f"{what}: expected numbers >= 0, each a largest deviation to both sides, got {x.min():g}")
    return x


def torques(value: Any, chain: ClosedChain, what: str) -> Array:
    """Return the torques at an action of 1, (n,) [N m or N]: a tenth of the effort limits if none are given."""
    if value is not None:
        return spread(value, chain.joint_count, f"{what}: joint_torque")
    limits = joint_limits(chain).effort
    return read_only(np.where(np.isfinite(limits), TENTH * limits, UNLIMITED))


def control_steps(task: Any, duration: float) -> int:
    """Return the number of control steps in a duration, at least one."""
    return max(1, round(duration / (task.step * task.steps_per_action)))
