"""Forward dynamics as a JAX function with gradients."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, Literal

from holdfast.compiled.chain import CompiledChain
from holdfast.compiled.derivative_schedule import WITH, derivative_shapes
from holdfast.compiled.foreign_code import answer_code, derivative_code
from holdfast.compiled.parameters import POSE_ARRAYS
from holdfast.errors import StateError
from holdfast.interop.jax_arguments import checked
from holdfast.interop.jax_call import Route, available_route, operation
from holdfast.interop.jax_import import require_jax
from holdfast.interop.jax_pose import pose_gradient, pose_tangent, rotation_and_origin
from holdfast.questions.arrays import FLOATING, POSES, STATE_AND_TORQUES, results_of

_FORCES = ("grasp_wrench", "base_wrench", "trunk_base_wrench")


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
        self._names = (*STATE_AND_TORQUES, *(FLOATING if compiled.chain.floats else ()), *parameters)
        shapes = {name: derivative_shapes(compiled.chain)[name] for name in self._names}
        self._shapes = {name: (*x[:-1], 7) if name in POSES else x for name, x in shapes.items()}
        code = answer_code(compiled.forward_dynamics, of, parameters)
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
            **parameters: those named in `to_jax`, and of a floating base floating_pose and floating_twist.

        Raises:
            StateError: a parameter is missing or unknown, a shape is wrong, or numbers are not real.
        """
        values = dict(zip(STATE_AND_TORQUES, (q, qd, tau, object_pose, object_twist), strict=True)) | parameters
        return self._function(*checked(values, self._shapes, len(STATE_AND_TORQUES)))

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
        code = derivative_code(self._compiled.forward_dynamics, kind, self.of, self._names)
        arrays = (*self._arrays_of(self._names), *(f"{WITH}{name}" for name in with_names))
        return operation(self._compiled, code, [name for name in arrays if name in code.externals], self.route)

    def _require_unique_forces(self) -> None:
        """Refuse derivatives of forces that are not unique, because they are meaningless."""
        rank, forces = self._compiled.generic_rank, [name for name in self.of if name in _FORCES]
        if forces and rank is not None and rank < self._compiled.chain.constraint_row_count:
            others = ", ".join(name for name in results_of(self._compiled.chain) if name not in _FORCES)
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
