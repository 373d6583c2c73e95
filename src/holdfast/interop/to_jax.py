"""Questions about compiled chains, and steps of rollouts, as JAX functions with gradients."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, Literal, overload

from holdfast.compiled.chain import CompiledChain
from holdfast.compiled.derivative_schedule import WITH
from holdfast.compiled.foreign_code import answer_code, derivative_code
from holdfast.compiled.function import Function
from holdfast.errors import StateError
from holdfast.interop.jax_arguments import checked, require_jax, require_names
from holdfast.interop.jax_call import JaxRoute, available_route, operation
from holdfast.interop.jax_pose import pose_gradient, pose_tangent, rotation_and_origin
from holdfast.interop.jax_rollout import JaxRollout
from holdfast.model import checks
from holdfast.questions.arrays import ARRAYS, FLOATING, MOVING, POSE_ARRAYS, POSES, results_of
from holdfast.simulation.rollout.rollout import Rollout

_FORCES = ("grasp_wrench", "base_wrench", "trunk_base_wrench")


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


class JaxFunction:
    """A question about a compiled chain as a JAX function; made by `to_jax`.

    Attributes:
        of: names of the results.
        parameters: names of the parameters that are given at each call.
        route: how the machine code is called: "ffi", by its address; or "callback", through Python, if JAX has no
            suitable FFI or does not compute on the CPU. The results are the same, about 0.2 ms later.
    """

    def __init__(
        self, function: Function, of: tuple[str, ...], parameters: tuple[str, ...], forward_mode: bool
    ) -> None:
        self.of, self.parameters, self._asked, chain = of, parameters, function, function.chain
        self.route: JaxRoute = available_route()
        question = function.question
        self._inputs = question.inputs
        self._names = (*question.inputs, *question.by_name(chain), *parameters)
        shapes = {name: ARRAYS[name].gradient_shape(chain) for name in self._names}
        self._shapes = {name: (*x[:-1], 7) if name in POSES else x for name, x in shapes.items()}
        code = answer_code(function, of, parameters)
        given = [name for name in self._arrays_of(self._names) if name in code.externals]
        self._forward = operation(chain, code, given, self.route)
        self._function = self._with_jvp() if forward_mode else self._with_vjp()

    def __call__(self, *given: Any, **parameters: Any) -> dict[str, Any]:
        """Return the results by name.

        Args:
            *given: the arrays that the question takes, in order or by name: of forward dynamics q, qd, tau,
                object_pose and object_twist.
            **parameters: those named in `to_jax`, and of a floating base floating_pose and floating_twist.

        Raises:
            StateError: an argument is missing or unknown, a shape is wrong, or numbers are not real.
        """
        if len(given) > len(self._inputs):
            raise StateError(f"expected {', '.join(self._inputs)}, got {len(given)} arguments")
        values = dict(zip(self._inputs, given, strict=False)) | parameters
        return self._function(*checked(values, self._shapes, len(self._inputs)))

    def _with_vjp(self) -> Any:
        """Return the function with its gradient."""
        function = require_jax().custom_vjp(self._values)

        def forward(*values: Any) -> tuple[dict[str, Any], tuple[Any, ...]]:
            return self._values(*values), values

        def backward(values: tuple[Any, ...], cotangents: dict[str, Any]) -> tuple[Any, ...]:
            given = self._arrays(values) | {f"{WITH}{name}": x for name, x in cotangents.items()}
            found = self._vjp(given)
            return tuple(pose_gradient(x, found[n]) if n in POSES else found[n] for n, x in self._named(values))

        function.defvjp(forward, backward)
        return function

    def _with_jvp(self) -> Any:
        """Return the function with its directional derivative."""
        function = require_jax().custom_jvp(self._values)

        @function.defjvp
        def _(values: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[dict[str, Any], dict[str, Any]]:
            given = self._arrays(values)
            for (name, x), rate in zip(self._named(values), tangents, strict=True):
                given[f"{WITH}{name}"] = pose_tangent(x, rate) if name in POSES else _varied(name, rate)
            return self._values(*values), self._jvp(given)

        return function

    def _values(self, *values: Any) -> dict[str, Any]:
        """Return the results."""
        return self._forward(self._arrays(values))

    @cached_property
    def _vjp(self) -> Any:
        """Machine code of the gradient, compiled when JAX first takes one."""
        return self._derivative("vjp", self.of)

    @cached_property
    def _jvp(self) -> Any:
        """Machine code of the directional derivative, compiled when JAX first takes one."""
        return self._derivative("jvp", self._names)

    def _derivative(self, kind: Literal["vjp", "jvp"], with_names: Sequence[str]) -> Any:
        self._require_unique_forces()
        code = derivative_code(self._asked, kind, self.of, self._names)
        arrays = (*self._arrays_of(self._names), *(f"{WITH}{name}" for name in with_names))
        return operation(self._asked.chain, code, [name for name in arrays if name in code.externals], self.route)

    def _require_unique_forces(self) -> None:
        """Refuse derivatives of forces that are not unique, because they are meaningless."""
        chain, rank = self._asked.chain, self._asked.compiled.generic_rank
        forces = [name for name in self.of if name in _FORCES and self._asked.has_status]
        if forces and rank is not None and rank < chain.constraint_row_count:
            others = ", ".join(name for name in results_of(chain) if name not in _FORCES)
            raise StateError(
                f"to_jax: {forces[0]}: the forces are not unique in this chain, and machine code finds one choice among"
                f" them, whose derivative means nothing; try of= some of {others}"
            )

    def _named(self, values: Sequence[Any]) -> zip[tuple[str, Any]]:
        return zip(self._names, values, strict=True)

    def _arrays_of(self, names: Sequence[str]) -> list[str]:
        """Return the names of arguments in the machine code."""
        return [own for name in names for own in POSE_ARRAYS.get(name, (name,))]

    def _arrays(self, values: Sequence[Any]) -> dict[str, Any]:
        """Return arguments with the names of the machine code."""
        found: dict[str, Any] = {}
        for name, x in self._named(values):
            if name in POSE_ARRAYS:
                found |= zip(POSE_ARRAYS[name], rotation_and_origin(x), strict=True)
            else:
                found[name] = x
        return found


def _varied(name: str, rate: Any) -> Any:
    """Return the rate of an argument; that of an inertia is made symmetric."""
    return (rate + rate.swapaxes(-1, -2)) / 2.0 if name.endswith("inertia") else rate
