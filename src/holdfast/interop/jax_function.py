"""Forward dynamics as a JAX function with gradients."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

from holdfast.compiled.chain import CompiledChain
from holdfast.compiled.derivative_schedule import WITH, derivative_shapes
from holdfast.compiled.foreign_code import derivative_code, forward_code
from holdfast.dynamics.closed.forward_derivatives import RESULTS
from holdfast.dynamics.derivatives import STATE_AND_TORQUES
from holdfast.errors import StateError
from holdfast.interop.jax_call import Route, available_route, operation
from holdfast.interop.jax_import import jax_numpy, require_jax
from holdfast.interop.jax_pose import pose_gradient, pose_tangent, rotation_and_origin
from holdfast.model import checks

_PARAMETERS = ("object_wrench", "gravity", "object_mass", "object_com", "object_inertia", "grasp_pose", "base_pose")
_PARAMETERS += ("base_twist", "base_acceleration")
_OF_LINKS = {"link_inertia": ("link_mass", "link_com", "link_inertia"), "link_wrench": ("link_wrench",)}
_POSES = {"base_pose": ("base_R", "base_p"), "grasp_pose": ("grasp_R", "grasp_p")}
_FORCES = ("grasp_wrench", "base_wrench")


def to_jax(
    compiled: CompiledChain,
    *,
    of: Sequence[str] = ("qdd", "grasp_wrench"),
    parameters: Sequence[str] = (),
    forward_mode: bool = False,
) -> JaxFunction:
    """Return forward dynamics as a JAX function for jit, grad, vmap and scan, which is computed on the CPU.

    f(q, qd, tau, object_pose, object_twist, **parameters) returns a dictionary of results. A gradient takes one call of
    the machine code of `forward_dynamics_vjp`, and a vmap one call for the batch. The gradient by a pose is that by its
    seven numbers, 2 (0, turn_bar) q for the quaternion; it has no component along the quaternion, whose length must
    stay 1. Results and gradients are NaN where there is no solution, and in states for which a single call raises an
    error. Only first derivatives are available.

    Args:
        compiled: chain returned by `holdfast.compile`. If its constraint is rank-deficient in every configuration, its
            `generic_rank` is needed, either given to `compile` or found by an earlier call; without it all results
            are NaN.
        of: the results, some of qdd (n,), grasp_wrench (arms, 6), object_acceleration (6,), contact_acceleration
            (n_g,), base_wrench (arms, 6).
        parameters: names of the parameters that are given at each call; the others are taken from the chain. They are
            object_wrench, gravity, object_mass, object_com, object_inertia, grasp_pose, base_pose, base_twist,
            base_acceleration, and those requested in `compile`; object_mass requires object_inertia.
        forward_mode: True for jvp and jacfwd, which JAX cannot provide together with grad and jacrev.

    Returns:
        The function.

    Raises:
        MissingExtra: jax is not installed.
        StateError: 64-bit numbers are disabled in JAX, or a name is unknown.
        MethodNotApplicable: the chain's base floats, or derivatives are not implemented for the chain.
    """
    require_jax()
    checks.instance(compiled, CompiledChain, "to_jax: compiled", StateError)
    checks.instance(forward_mode, bool, "to_jax: forward_mode", StateError)
    asked = [name for option, names in _OF_LINKS.items() if _has(compiled, option) for name in names]
    for names, known, what in ((of, RESULTS, "of"), (parameters, (*_PARAMETERS, *asked), "parameters")):
        checks.instance(names, (list, tuple), f"to_jax: {what}", StateError)
        for name in names:
            if name not in known:
                raise StateError(f"to_jax: {what}: no {name!r}.{checks.did_you_mean(str(name), known)}")
    if not of:
        raise StateError(f"to_jax: of: expected some results of {', '.join(RESULTS)}, got none")
    if "object_mass" in parameters and "object_inertia" not in parameters:
        raise StateError(
            "to_jax: parameters: expected object_inertia beside object_mass, as another mass rarely leaves the inertia"
            " as it is; try giving object_mass / m0 times the chain's own"
        )
    return JaxFunction(compiled, tuple(dict.fromkeys(of)), tuple(dict.fromkeys(parameters)), forward_mode)


class JaxFunction:
    """Forward dynamics as a JAX function; made by `to_jax`.

    Attributes:
        of: names of the results.
        parameters: names of the parameters that are given at each call.
        route: how the machine code is called: "ffi", by its address; or "callback", through Python, if JAX has no
            suitable FFI or does not compute on the CPU. The results are the same, about 0.2 ms later.
    """

    def __init__(
        self, compiled: CompiledChain, of: tuple[str, ...], parameters: tuple[str, ...], forward_mode: bool
    ) -> None:
        self.of, self.parameters, self._compiled = of, parameters, compiled
        self.route: Route = available_route()
        self._names = (*STATE_AND_TORQUES, *parameters)
        self._shapes = {name: derivative_shapes(compiled.chain)[name] for name in self._names}
        for name in {*_POSES, "object_pose"} & {*self._names}:
            self._shapes[name] = (*self._shapes[name][:-1], 7)
        code = forward_code(compiled, of, parameters)
        given = [name for name in self._arrays_of(self._names) if name in code.externals]
        self._forward = operation(compiled, code, given, self.route)
        self._function = self._with_jvp() if forward_mode else self._with_vjp()

    def __call__(
        self, q: Any, qd: Any, tau: Any, object_pose: Any, object_twist: Any, **parameters: Any
    ) -> dict[str, Any]:
        """Return the results by name.

        Args:
            q: (n,) joint positions, arms in order, base to tip [rad or m].
            qd: joint rates.
            tau: joint torques [N m or N].
            object_pose: (7,) wxyz_xyz of the object frame.
            object_twist: (6,) [omega; v of C], world axes.
            **parameters: those named in `to_jax`.

        Raises:
            StateError: a parameter is missing or unknown, a shape is wrong, or numbers are not real.
        """
        require_jax()
        if parameters.keys() != {*self.parameters}:
            expected = ", ".join(self.parameters) or "none"
            raise StateError(f"parameters: expected {expected}, got {', '.join(parameters) or 'none'}; see to_jax")
        values = dict(zip(STATE_AND_TORQUES, (q, qd, tau, object_pose, object_twist), strict=True)) | parameters
        return self._function(*(self._numbers(name, values[name]) for name in self._names))

    def _numbers(self, name: str, value: Any) -> Any:
        """Return an argument as an array of 64-bit numbers, after checking its shape."""
        jnp = jax_numpy()
        try:
            x = jnp.asarray(value)
        except (TypeError, ValueError) as cause:
            raise StateError(f"{name}: expected real numbers, got {checks.short(value)}") from cause
        if not (jnp.issubdtype(x.dtype, jnp.floating) or jnp.issubdtype(x.dtype, jnp.integer)):
            raise StateError(f"{name}: expected real numbers, got {x.dtype}")
        if x.shape != self._shapes[name]:
            raise StateError(f"{name}: expected shape {self._shapes[name]}, got {x.shape}; try jax.vmap for a batch")
        return x.astype(jnp.float64)

    def _with_vjp(self) -> Any:
        """Return the function with its gradient."""
        function = require_jax().custom_vjp(self._values)

        def forward(*values: Any) -> tuple[dict[str, Any], tuple[Any, ...]]:
            return self._values(*values), values

        def backward(values: tuple[Any, ...], cotangents: dict[str, Any]) -> tuple[Any, ...]:
            given = self._arrays(values) | {f"{WITH}{name}": x for name, x in cotangents.items()}
            found = self._vjp(given)
            bars = (pose_gradient(x, found[n]) if _is_pose(n) else found[n] for n, x in self._named(values))
            return tuple(bars)

        function.defvjp(forward, backward)
        return function

    def _with_jvp(self) -> Any:
        """Return the function with its directional derivative."""
        function = require_jax().custom_jvp(self._values)

        @function.defjvp
        def _(values: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[dict[str, Any], dict[str, Any]]:
            given = self._arrays(values)
            for (name, x), rate in zip(self._named(values), tangents, strict=True):
                given[f"{WITH}{name}"] = pose_tangent(x, rate) if _is_pose(name) else _varied(name, rate)
            return self._values(*values), self._jvp(given)

        return function

    def _values(self, *values: Any) -> dict[str, Any]:
        """Return the results."""
        return self._forward(self._arrays(values))

    @cached_property
    def _vjp(self) -> Any:
        """Machine code of the gradient, compiled when JAX first takes one."""
        self._require_unique_forces()
        code = derivative_code(self._compiled, "vjp", self.of, self._names)
        return self._operation_of(code, self.of)

    @cached_property
    def _jvp(self) -> Any:
        """Machine code of the directional derivative, compiled when JAX first takes one."""
        self._require_unique_forces()
        code = derivative_code(self._compiled, "jvp", self.of, self._names)
        return self._operation_of(code, self._names)

    def _operation_of(self, code: Any, with_names: Sequence[str]) -> Any:
        arrays = (*self._arrays_of(self._names), *(f"{WITH}{name}" for name in with_names))
        return operation(self._compiled, code, [name for name in arrays if name in code.externals], self.route)

    def _require_unique_forces(self) -> None:
        """Refuse derivatives of forces that are not unique, because they are meaningless."""
        rank, forces = self._compiled.generic_rank, [name for name in self.of if name in _FORCES]
        if forces and rank is not None and rank < self._compiled.chain.constraint_row_count:
            others = ", ".join(name for name in RESULTS if name not in _FORCES)
            raise StateError(
                f"to_jax: {forces[0]}: the forces are not unique in this chain, and machine code finds one choice among"
                f" them, whose derivative means nothing; try of= some of {others}"
            )

    def _named(self, values: Sequence[Any]) -> zip[tuple[str, Any]]:
        return zip(self._names, values, strict=True)

    def _arrays_of(self, names: Sequence[str]) -> list[str]:
        """Return the names of arguments in the machine code."""
        return [own for name in names for own in _POSES.get(name, (name,))]

    def _arrays(self, values: Sequence[Any]) -> dict[str, Any]:
        """Return arguments with the names of the machine code."""
        found: dict[str, Any] = {}
        for name, x in self._named(values):
            if name in _POSES:
                found |= zip(_POSES[name], rotation_and_origin(x), strict=True)
            else:
                found[name] = x
        return found


def _has(compiled: CompiledChain, option: str) -> bool:
    """Return whether an optional parameter was requested in `compile`."""
    options = compiled.options
    return options.link_inertia if option == "link_inertia" else options.link_wrenches


def _is_pose(name: str) -> bool:
    return name.endswith("_pose")


def _varied(name: str, rate: Any) -> Any:
    """Return the rate of an argument; that of an inertia is made symmetric."""
    return (rate + rate.swapaxes(-1, -2)) / 2.0 if name.endswith("inertia") else rate
