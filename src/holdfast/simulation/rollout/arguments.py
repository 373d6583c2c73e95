"""Checks of the arguments of a rollout: parameters of the law and of the chain, step lengths and counts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from holdfast.compiled import arrays
from holdfast.compiled.parameters import WRENCHES, parse_parameters
from holdfast.control.controller import ControlLaw, holds_torques
from holdfast.control.sampled import EARLY, SampledTorque, require_steps
from holdfast.dynamics.tree.mechanism_terms import require_passive
from holdfast.errors import ModelError, StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import FLOATING, LINKS, STATE, TRUNK_LINKS, shapes, state_fields
from holdfast.simulation.rollout.kernel import StepKernel
from holdfast.simulation.rollout.systems import RolloutSystems
from holdfast.simulation.rollout.traced_step import LIMITED, SLIPPED
from holdfast.spatial.scalar import Array

StopMargins = Mapping[int, float]  # margins below which a system stops, by the status code that it then gets
NO_STOPS: StopMargins = {SLIPPED: -np.inf, LIMITED: -np.inf}
MOST_STEPS_OF_CALL = 10**9  # of one call: days, beyond which a count is a slip
CHAINS = ("object_wrench", "gravity", "object_mass", "object_com", "object_inertia", "base_pose", "grasp_pose")
LINK_ARGUMENTS = (*LINKS, *TRUNK_LINKS, "link_wrench", "trunk_link_wrench")
_OWN = ("systems", *STATE, *FLOATING, "memory", "t", "step", "steps", "duration", "every")
_OPTIONS = ("record", "least_margin", "stop_at_limits", "largest_drift", "threads", "self")
_TAKEN = (*CHAINS, *LINK_ARGUMENTS, *_OWN, *_OPTIONS)


def require_free_names(parameters: Mapping[str, Any]) -> None:
    """Refuse parameters of a law that have the name of another argument of a rollout.

    Raises:
        ModelError: there is such a parameter; the message names the first.
    """
    for name in parameters:
        if name in _TAKEN:
            raise ModelError(
                f"control law: parameter '{name}': expected a name of its own, got one that rollouts use"
                f" ({', '.join(_TAKEN)}); try another"
            )


def state_arguments(chain: ClosedChain, *given: Any) -> dict[str, Any]:
    """Return the state passed to `start`, by the names of its arrays.

    Args:
        chain: the chain.
        given: arrays in the order of `STATE` and `FLOATING`; the latter are None without a floating base.

    Raises:
        StateError: a part of the state is missing, or is given although no base floats.
    """
    named = dict(zip((*STATE, *FLOATING), given, strict=True))
    for name in STATE:
        if named[name] is None:
            shape = shapes(chain)[name]
            if math.prod(shape):
                raise StateError(f"{name}: expected shape {checks.shapes_with_rows(shape, 'systems')}, got none")
            named[name] = np.zeros(shape)
    for name in FLOATING:
        if chain.floats and named[name] is None:
            raise StateError(f"{name}: expected that of the trunk's floating base, got none")
        if not chain.floats and named[name] is not None:
            raise StateError(f"{name}: expected none, as the chain has no floating base")
    return {name: named[name] for name in state_fields(chain)}


def call_inputs(kernel: StepKernel, given: Mapping[str, Any], count: int) -> dict[str, Array]:
    """Return the arguments of a call with the names of the machine code, (1 or systems, *shape) each.

    Args:
        kernel: the kernel of a step.
        given: parameters of the law, arguments in `CHAINS`, and those in `LINK_ARGUMENTS` if the kernel has been
            compiled with them.
        count: number of systems; an array has one row per system, or one value for all.

    Raises:
        StateError: a name is unknown, a shape is wrong, a parameter of the chain is not finite, or a passive joint has
            a torque.
    """
    laws, chains = kernel.law.parameters, {}
    fixed = kernel.code.constant
    known = [*chain_arguments(kernel), *(name for name in LINK_ARGUMENTS if name in kernel.externals)]
    found: dict[str, Array] = {}
    for name, x in given.items():
        if name in laws:
            found[f"control.{name}"] = _rows(fitting(name, x, laws[name], count), laws[name])
            if fixed and holds_torques(kernel.law):
                require_passive(kernel.chain, np.abs(found["control.tau"]).max(axis=0, initial=0.0))
        elif name == "base_pose" and kernel.motions:
            raise StateError(f"base_pose: expected none, as {', '.join(kernel.motions)} moves as `base_motion` says")
        elif name in known:
            chains[name] = x
        elif fixed and name in CHAINS + LINK_ARGUMENTS and name not in WRENCHES:
            raise StateError(
                f"{name}: expected none, as the numbers of a chain that is answered as a forest are constants of its"
                " machine code, but for gravity and those of an only object; try a rollout of another chain"
            )
        elif name in LINK_ARGUMENTS:
            option = "link_wrench" if name in WRENCHES else "link_inertia"
            raise StateError(
                f"{name}: the machine code was made without it; try compile_rollout(..., parameters=['{option}'])"
            )
        else:
            raise StateError(f"no parameter '{name}'.{checks.did_you_mean(name, (*laws, *known))}")
    for name, x in (parse_parameters(chains, kernel.externals, kernel.chain) if chains else {}).items():
        shape = kernel.externals[name].shape
        found[name] = _rows(fitting(name, x, shape, count), shape)
    return found


def chain_arguments(kernel: StepKernel) -> list[str]:
    """Return those of `CHAINS` that a kernel takes; chains that are answered as forests are constants of theirs."""
    return [name for name in CHAINS if name in kernel.externals] if kernel.code.constant else [*CHAINS]


def kernel_arguments(kernel: StepKernel, given: Mapping[str, Array]) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the inputs and the parameters of the machine code from the arguments of all calls so far.

    Args:
        kernel: the kernel of a step.
        given: arguments as `call_inputs` returns them; parameters of other laws are ignored.

    Raises:
        StateError: a parameter of the law has never been given, or the systems belong to another chain.
    """
    wrenches = [name for name in ("object_wrench", *WRENCHES) if name in kernel.externals]
    inputs = {name: np.zeros(kernel.externals[name].shape) for name in wrenches}
    parameters: dict[str, Array] = {}
    for name, x in given.items():
        external = kernel.externals.get(name)
        if external is not None and x.shape[1:] == external.shape:
            (parameters if external.role == "parameter" else inputs)[name] = x[0] if len(x) == 1 else x
        elif not name.startswith("control."):
            raise StateError(
                f"systems: {name} was given in shape {x.shape[1:]}, which this rollout's chain has not; try systems"
                " that `start` of this rollout returned"
            )
    for name, shape in kernel.law.parameters.items():
        if f"control.{name}" in inputs:
            continue
        if math.prod(shape):
            raise StateError(
                f"the control law's parameter '{name}' is missing: expected shape {shape}; try start(..., {name}=...)"
            )
        inputs[f"control.{name}"] = np.zeros(shape)  # such as the torques of no joint
    return inputs, parameters


def _rows(x: Array, shape: tuple[int, ...]) -> Array:
    return x if x.ndim > len(shape) else x[None]


def fitting(name: str, value: Any, shape: tuple[int, ...], count: int) -> Array:
    """Return a value as a float64 array of the given shape, or with one row per system.

    Raises:
        StateError: it has another shape.
    """
    x = arrays.floats(name, value, shape)
    if x.ndim > len(shape) and len(x) != count:
        raise StateError(f"{name}: expected shape {checks.shapes_with_rows(shape, count)}, got {x.shape}")
    return x


def number(name: str, value: Any, infinite: bool = False) -> float:
    """Return the value as a float, which must be finite unless `infinite` is True.

    Raises:
        StateError: it is not such a number.
    """
    try:
        x = np.nan if isinstance(value, str | bytes | bool | np.bool_) else float(value)
    except (TypeError, ValueError, OverflowError):
        x = np.nan
    if np.isnan(x) or not (infinite or np.isfinite(x)):
        raise StateError(f"{name}: expected a {'' if infinite else 'finite '}number, got {checks.short(value)}")
    return x


def whole_number(name: str, value: Any, most: int | None = None) -> int:
    """Return the value as an integer, which must be at least one and at most `most`.

    Raises:
        StateError: it is not such an integer.
    """
    if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < 1:
        raise StateError(f"{name}: expected an integer >= 1, got {checks.short(value)}")
    if most is not None and value > most:
        raise StateError(f"{name}: expected at most {most}, got {checks.short(value)}")
    return int(value)


def require_systems(systems: Any) -> None:
    """Refuse what is not the systems of a rollout.

    Raises:
        StateError: it is something else.
    """
    if not isinstance(systems, RolloutSystems):
        raise StateError(
            f"systems: expected those that `start` returned, got {type(systems).__name__}; try rollout.start(q, qd,"
            " object_pose, object_twist)"
        )


def step_lengths(step: Any, count: int) -> Array:
    """Return the length of each system's step, (count,) [s].

    Raises:
        StateError: it is not positive, or of another shape.
    """
    try:
        h = checks.numbers(step, None, "step", StateError)
    except StateError:
        h = np.array(np.nan)
    if not (h > 0).all() or h.shape not in ((), (count,)):
        raise StateError(
            f"step: expected one positive number of seconds, or one for each system, got {checks.short(step)}"
        )
    return np.array(np.broadcast_to(h, (count,)))


def require_at_samples(law: ControlLaw, systems: RolloutSystems, lengths: Array) -> None:
    """Refuse steps that do not end at the samples of a sampled law.

    Args:
        law: the control law.
        systems: the systems before the steps.
        lengths: (systems,) lengths of the steps [s].

    Raises:
        StateError: a step does not divide the sample time or the delay, or the time since the last sample.
    """
    require_steps(law, lengths)
    if not isinstance(law.torque, SampledTorque):
        return
    last, count = law.torque.last_samples(systems.arrays["memory"])
    since = np.where(systems.running & (count > 0.5), systems.t - last, 0.0)
    parts = since / lengths
    if len(rows := np.flatnonzero(np.abs(parts - np.rint(parts)) > EARLY * np.maximum(1.0, parts))):
        row = int(rows[0])
        raise StateError(
            f"step: expected steps that end at samples, got {lengths[row]:g} s at {since[row]:.6g} s after the last"
            f" sample of system {row}; try steps of {since[row]:.6g} s until the next sample"
        )


def whole_steps(duration: float, step: float) -> int:
    """Return the number of steps in a duration.

    Raises:
        StateError: the duration is not a whole number of steps.
    """
    count = duration / step
    steps = round(count) if np.isfinite(count) else 0
    if steps < 1 or abs(steps * step - duration) > 1e-9 * duration:
        raise StateError(f"duration: expected a whole number of steps of {step:g} s, got {duration:g} s")
    return whole_number("duration / step", steps, MOST_STEPS_OF_CALL)


def stop_margins(least_margin: float, stop_at_limits: bool) -> StopMargins:
    """Return the margins below which systems stop, by status code."""
    checks.flag(stop_at_limits, "stop_at_limits", StateError)
    least, of_joints = number("least_margin", least_margin, infinite=True), 0.0 if stop_at_limits else -np.inf
    return {SLIPPED: least, LIMITED: of_joints}


def drift_limit(largest_drift: float | None) -> float | None:
    """Return the largest position gap that a step may leave before projection, or None."""
    return None if largest_drift is None else checks.number(largest_drift, "largest_drift", above=0.0)


def step_options(least_margin: float, stop_at_limits: bool, largest_drift: float | None) -> dict[str, Any]:
    """Return the options of `Rollout.step`, checked, as they are written to a record's metadata."""
    least = stop_margins(least_margin, stop_at_limits)[SLIPPED]
    limit = drift_limit(largest_drift)
    return {"least_margin": least, "stop_at_limits": bool(stop_at_limits), "largest_drift": limit}


def common_time(systems: RolloutSystems) -> float:
    """Return the time of the running systems, which must be the same for all of them."""
    times = np.unique(systems.t[systems.running]) if systems.running.any() else systems.t.max(keepdims=True)
    if times[-1] - times[0] > 1e-9 * max(1.0, abs(times[0])):
        raise StateError(
            f"systems: expected all at one time, got {times[0]:g} s to {times[-1]:g} s; a record has one time axis; try"
            " `step`"
        )
    return float(times[0])


def step_inputs(systems: RolloutSystems, least: StopMargins, notice: bool = False) -> dict[str, Array]:
    """Return the inputs of the machine code other than torques and wrenches: times, and what stops systems."""
    return {
        "begin": systems.begin,
        "step": systems.step_length,
        "held": np.array(0.0),
        "notice": np.array(float(notice)),
        "least_margin": np.array(least[SLIPPED]),
        "least_joint_margin": np.array(least[LIMITED]),
    }
