"""What a call of a rollout is told besides its systems: the law's parameters and the chain's, checked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from holdfast.compiled import arrays
from holdfast.compiled.parameters import taken
from holdfast.errors import ModelError, StateError
from holdfast.model import checks
from holdfast.simulation.rollout.kernel import StepKernel
from holdfast.spatial.scalar import Array

# Axes of a system's own by name, where a user's array has others than the machine code's.
_POSES = {"base_pose": 2, "grasp_pose": 2}
CHAINS = ("object_wrench", "gravity", "object_mass", "object_com", "object_inertia", *_POSES)
_OWN = ("systems", "q", "qd", "object_pose", "object_twist", "memory", "t", "step", "steps", "duration", "every")
_TAKEN = (*CHAINS, *_OWN, "record", "least_margin", "threads", "self")


def require_free_names(parameters: Mapping[str, Any]) -> None:
    """Refuse parameters of a law that a rollout's calls have arguments of the same name for.

    Raises:
        ModelError: naming the first.
    """
    for name in parameters:
        if name in _TAKEN:
            raise ModelError(
                f"control law: parameter '{name}': expected a name of its own, got one that rollouts use"
                f" ({', '.join(_TAKEN)}); try another"
            )


def told(kernel: StepKernel, given: Mapping[str, Any], count: int) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the machine code's inputs and parameters that a call gives.

    Args:
        kernel: a step under a law.
        given: the law's parameters, all of them, and any of `CHAINS`.
        count: how many systems; an array has a row for each of them, or is for all.

    Raises:
        StateError: a missing or unknown name, a wrong shape, numbers that are not finite (of the chain's).
    """
    inputs: dict[str, Array] = {"object_wrench": np.zeros(6)}
    rest = dict(given)
    for name, shape in kernel.law.parameters.items():
        if name not in rest:
            raise StateError(f"the control law's parameter '{name}' is missing: expected shape {shape}")
        inputs[f"control.{name}"] = fitting(name, rest.pop(name), shape, count)
    for name in rest:
        if name not in CHAINS:
            raise StateError(f"no parameter '{name}'.{checks.did_you_mean(name, (*kernel.law.parameters, *CHAINS))}")
    changed = taken(rest, kernel.externals) if rest else {}
    for name, x in changed.items():
        fitting(name, x, kernel.externals[name].shape, count)
    if "object_wrench" in changed:
        inputs["object_wrench"] = changed.pop("object_wrench")
    return inputs, changed


def some(kernel: StepKernel, given: Mapping[str, Any], rows: Array) -> dict[str, Any]:
    """Return what is given to some of the systems, `rows` (systems,) of truth values."""
    shapes = {name: e.shape for name, e in kernel.externals.items()} | dict(kernel.law.parameters)
    own = {}
    for name, x in given.items():
        rank = _POSES.get(name, len(shapes.get(name, ())))
        own[name] = np.asarray(x)[rows] if np.ndim(x) > rank else x
    return own


def fitting(name: str, value: Any, shape: tuple[int, ...], count: int) -> Array:
    """Return a value as a float64 array of a shape, or with a row for each system.

    Raises:
        StateError: it has another shape.
    """
    x = arrays.floats(name, value, shape)
    if x.ndim > len(shape) and len(x) != count:
        raise StateError(f"{name}: expected shape {shape} or ({count}, *{shape}), got {x.shape}")
    return x


def number(name: str, value: Any, infinite: bool = False) -> float:
    """Return a number, finite unless infinite ones are welcome.

    Raises:
        StateError: it is none.
    """
    try:
        x = float(value)
    except (TypeError, ValueError):
        x = np.nan
    if np.isnan(x) or not (infinite or np.isfinite(x)):
        raise StateError(f"{name}: expected a {'' if infinite else 'finite '}number, got {value!r}")
    return x


def paces(step: Any, count: int) -> Array:
    """Return the length of each system's step, (count,) [s].

    Raises:
        StateError: it is not positive, or of another shape.
    """
    try:
        h = np.asarray(step, dtype=float)
    except (TypeError, ValueError):
        h = np.array(np.nan)
    if not (np.isfinite(h).all() and (h > 0).all()) or h.shape not in ((), (count,)):
        raise StateError(f"step: expected one positive number of seconds, or one for each system, got {step!r}")
    return np.array(np.broadcast_to(h, (count,)))


def whole_steps(duration: float, step: float) -> int:
    """Return how many steps a duration is.

    Raises:
        StateError: it is no whole number of them.
    """
    steps = round(duration / step)
    if steps < 1 or abs(steps * step - duration) > 1e-9 * duration:
        raise StateError(f"duration: expected a whole number of steps of {step:g} s, got {duration:g} s")
    return steps
