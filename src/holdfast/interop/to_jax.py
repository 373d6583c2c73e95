"""Compiled forward dynamics, and steps of rollouts, as functions of JAX."""

from __future__ import annotations

from collections.abc import Sequence
from typing import overload

from holdfast.compiled.chain import CompiledChain
from holdfast.compiled.externals import BASE_MOTION, TRUNK_BASE_MOTION, link_parameters
from holdfast.dynamics.closed.forward_derivatives import results_of
from holdfast.errors import StateError
from holdfast.interop.jax_arguments import require_names
from holdfast.interop.jax_function import JaxFunction
from holdfast.interop.jax_import import require_jax
from holdfast.interop.jax_rollout import JaxRollout
from holdfast.model import checks
from holdfast.simulation.rollout.rollout import Rollout

_PARAMETERS = ("object_wrench", "gravity", "object_mass", "object_com", "object_inertia", "grasp_pose", "base_pose")


@overload
def to_jax(
    dynamics: CompiledChain, *, of: Sequence[str] = ..., parameters: Sequence[str] = ..., forward_mode: bool = ...
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
    dynamics: CompiledChain | Rollout,
    *,
    of: Sequence[str] | None = None,
    parameters: Sequence[str] = (),
    forward_mode: bool = False,
    step: float | None = None,
    steps: int | None = None,
    schedule: Sequence[str] = (),
) -> JaxFunction | JaxRollout:
    """Return forward dynamics, or a rollout, as a function of JAX: under jit, grad, vmap and scan, on the processor.

    f(q, qd, tau, object_pose, object_twist, **parameters) is a dictionary of the results of forward dynamics. A
    gradient is one call of the machine code of `forward_dynamics_vjp`, a vmap one call of a batch.

    Of a rollout, f(q, qd, object_pose, object_twist, **parameters) has the results at the end of every step, (steps,
    ...) each. A gradient is one of `Rollout.tape`, which takes the steps again, a vmap one rollout of many systems.
    Both go through Python.

    The gradient by a pose is by its seven numbers, 2 (0, turn_bar) q, with no part along the quaternion, whose length
    must stay 1. Where there is no answer, after the step at which a system stands still, and in states that a single
    call refuses, results and gradients are not-a-number. First derivatives only.

    Args:
        dynamics: what `holdfast.compile` or `holdfast.compile_rollout` returned. A compiled chain of constantly low
            rank needs its `generic_rank`, given there or found by an earlier call; without it all of its results are
            not-a-number.
        of: the results. Of forward dynamics some of qdd (n,), grasp_wrench (arms, 6), object_acceleration (6,),
            contact_acceleration (n_g,), base_wrench (arms, 6), with a trunk trunk_base_wrench (6,), with a floating
            base floating_acceleration (6,); qdd and grasp_wrench by default. Of a rollout arrays of `RolloutSystems`
            that have derivatives: the state, by default, memory, tau, qdd, grasp_wrench, accelerations.
        parameters: which will be given by name at each call, the others being the chain's own: object_wrench,
            gravity, object_mass, object_com, object_inertia, grasp_pose, base_pose, base_twist, base_acceleration,
            those asked for in `compile` or `compile_rollout`, and of a rollout the law's memory; with an object_mass
            goes an object_inertia. A floating base's pose and twist, and all parameters of a rollout's law, are always
            given.
        forward_mode: True for jvp and jacfwd of forward dynamics, which JAX cannot offer beside grad and jacrev for
            one function.
        step: of a rollout [s].
        steps: of a rollout, how many.
        schedule: parameters of a rollout's law that have a row for every step, (steps, ...).

    Returns:
        The function.

    Raises:
        MissingExtra: jax is not installed.
        StateError: JAX's 64-bit numbers are off; names that are not there; a rollout without steps.
        MethodNotApplicable: derivatives are not there yet for the chain.
    """
    require_jax()
    checks.instance(dynamics, (CompiledChain, Rollout), "to_jax: dynamics", StateError)
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
    results = require_names("of", ("qdd", "grasp_wrench") if of is None else of, results_of(dynamics.chain))
    return JaxFunction(dynamics, results, require_names("parameters", parameters, _known(dynamics)), forward_mode)


def _known(compiled: CompiledChain) -> tuple[str, ...]:
    """Return which parameters may be given."""
    chain, options = compiled.chain, compiled.options
    known = [*_PARAMETERS, *BASE_MOTION, *(link_parameters(chain) if options.link_inertia else ())]
    if options.link_wrenches:
        known += ["link_wrench", *(["trunk_link_wrench"] if chain.trunk is not None else [])]
    return (*known, *(TRUNK_BASE_MOTION if chain.trunk is not None and not chain.floats else ()))
