"""Compiled forward dynamics and steps of rollouts as JAX functions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import overload

from holdfast.compiled.chain import CompiledChain
from holdfast.compiled.function import Function
from holdfast.errors import StateError
from holdfast.interop.jax_arguments import require_names
from holdfast.interop.jax_function import JaxFunction
from holdfast.interop.jax_import import require_jax
from holdfast.interop.jax_rollout import JaxRollout
from holdfast.model import checks
from holdfast.questions.arrays import FLOATING, MOVING, POSE_ARRAYS
from holdfast.simulation.rollout.rollout import Rollout


@overload
def to_jax(
    dynamics: CompiledChain | Function,
    *,
    of: Sequence[str] = ...,
    parameters: Sequence[str] = ...,
    forward_mode: bool = ...,
) -> JaxFunction: ...
@overload
def to_jax(
    dynamics: Rollout,
    *,
    step: float,
    steps: int,
    of: Sequence[str] = ...,
    parameters: Sequence[str] = ...,
    schedule: Sequence[str] = ...,
) -> JaxRollout: ...
def to_jax(
    dynamics: CompiledChain | Function | Rollout,
    *,
    of: Sequence[str] | None = None,
    parameters: Sequence[str] = (),
    forward_mode: bool = False,
    step: float | None = None,
    steps: int | None = None,
    schedule: Sequence[str] = (),
) -> JaxFunction | JaxRollout:
    """Return a compiled question or a rollout as a JAX function that works under jit, grad, vmap and scan, on the CPU.

    Of a compiled chain, f(q, qd, tau, object_pose, object_twist, **parameters) returns a dictionary of the results of
    forward dynamics; of a function of it, such as `compiled.kinetic_energy`, f takes the arrays of that question. A
    gradient is one call of the machine code of its `vjp`; a vmap is one call for a batch.

    For a rollout, f(q, qd, object_pose, object_twist, **parameters) returns the results at the end of every step,
    (steps, ...) each. A gradient is that of `Rollout.tape`, which repeats the steps; a vmap is one rollout of many
    systems. Both go through Python.

    The gradient with respect to a pose has seven entries. Its quaternion part is 2 (0, turn_bar) q, which has no
    component along the quaternion, because the length of that must stay 1. In states that a single call refuses, and
    after a system has stopped, results and gradients are NaN. Only first derivatives are available.

    Args:
        dynamics: the result of `holdfast.compile`, a function of it, or a rollout. A compiled chain of constantly low
            rank needs its `generic_rank`, given there or found by an earlier call; otherwise all results are NaN.
        of: names of the results. For forward dynamics, any of qdd (n,), grasp_wrench (arms, 6), object_acceleration
            (6,), contact_acceleration (n_g,), base_wrench (arms, 6), with a trunk trunk_base_wrench (6,), with a
            floating base floating_acceleration (6,); the default is qdd and grasp_wrench. For a rollout, arrays of
            `RolloutSystems` that have derivatives: those of the state (the default), memory, tau, qdd, grasp_wrench and
            accelerations.
        parameters: names of the parameters that are passed to each call; the others are the chain's own. They are
            object_wrench, gravity, object_mass, object_com, object_inertia, grasp_pose, base_pose, base_twist,
            base_acceleration, those requested from `compile` or `compile_rollout`, and the memory of a rollout's law.
            An object_mass requires an object_inertia. The pose and twist of a floating base, and all parameters of a
            rollout's law, are always passed.
        forward_mode: True for jvp and jacfwd of forward dynamics; JAX does not support these and grad and jacrev for
            the same function.
        step: step h of a rollout [s].
        steps: number of steps of a rollout.
        schedule: parameters of a rollout's law that have a row for every step, (steps, ...).

    Returns:
        The function.

    Raises:
        MissingExtra: jax is not installed.
        StateError: JAX's 64-bit numbers are disabled, a name is unknown, or a rollout has no steps.
        MethodNotApplicable: derivatives are not available for the chain.
    """
    require_jax()
    checks.instance(dynamics, (CompiledChain, Function, Rollout), "to_jax: dynamics", StateError)
    checks.instance(forward_mode, bool, "to_jax: forward_mode", StateError)
    checks.instance(of, (list, tuple, type(None)), "to_jax: of", StateError)
    checks.instance(parameters, (list, tuple), "to_jax: parameters", StateError)
    if of is not None and not of:
        raise StateError("to_jax: of: expected some results, got none")
    if "object_mass" in parameters and "object_inertia" not in parameters:
        raise StateError(
            "to_jax: parameters: expected object_inertia beside object_mass, as another mass rarely leaves the inertia"
            " as it is; try giving object_mass / m0 times the chain's own"
        )
    if isinstance(dynamics, Rollout):
        if step is None or steps is None or forward_mode:
            raise StateError("to_jax: expected step and steps of a rollout, and no forward_mode")
        return JaxRollout(dynamics, of, parameters, step, steps, schedule)
    if step is not None or steps is not None or schedule:
        raise StateError("to_jax: expected neither step, steps nor schedule of forward dynamics")
    function = dynamics.forward_dynamics if isinstance(dynamics, CompiledChain) else dynamics
    question, known = function.question, function.question.names_at(function.chain)
    results = require_names("of", (question.of or known) if of is None else of, known)
    return JaxFunction(function, results, require_names("parameters", parameters, _known(function)), forward_mode)


def _known(function: Function) -> tuple[str, ...]:
    """Return the names of the parameters that may be passed: those by which the question has derivatives."""
    held = {*function.externals, *(MOVING if function.has_status else ())}
    known = [name for name in function.question.arguments_at(function.chain) if name not in function.question.inputs]
    return tuple(name for name in known if name not in FLOATING and POSE_ARRAYS.get(name, (name,))[0] in held)
