"""Derivatives of a compiled chain's functions that solve nothing; their machine code is made when first requested."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any, get_args

from holdfast.compiled import arrays
from holdfast.compiled.arm_functions import own_inputs
from holdfast.compiled.bound_function import BoundFunctionDerivatives
from holdfast.compiled.compiled_derivatives import options_of
from holdfast.compiled.derivative_computation import DIFFERENTIABLE, FunctionRequest
from holdfast.compiled.derivative_schedule import FOUND, Kind
from holdfast.compiled.function import CompiledFunction
from holdfast.compiled.methods import ChainMethods
from holdfast.compiled.not_compiled import require_holding
from holdfast.compiled.possible_motion import possible
from holdfast.dynamics.closure_derivatives import by_grasps
from holdfast.dynamics.derivatives import Derivatives, require_names
from holdfast.errors import StateError
from holdfast.forces.margins import JointMargins
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array

HOLDING = ("inverse_dynamics", "wrist_wrenches")  # functions that refuse wrenches of arms that hold nothing


def result_of(function: str, chain: ClosedChain, found: Sequence[Array]) -> Any:
    """Return a function's result, made of its results in order; a number if that is an array without axes."""
    if function == "closure":
        return by_grasps(chain, *found)
    if function == "joint_margins":
        return JointMargins(*found)
    (x,) = found
    return x if x.ndim else float(x)


class DerivativeMethods(ChainMethods):
    """What the derivatives of a `CompiledChain`'s functions that solve nothing have in common."""

    def _derived(
        self,
        function: str,
        kind: Kind,
        inputs: Sequence[Any],
        of: Sequence[str],
        by: Collection[str],
        given: Mapping[str, Any],
        parameters: Mapping[str, Any],
        threads: int,
    ) -> Derivatives:
        """Return derivatives of a function; their machine code is made when first requested.

        Args:
            function: its name.
            kind: of the derivatives.
            inputs: the function's inputs.
            of: the results to differentiate.
            by: the arguments by which they are differentiated.
            given: cotangents by result, or tangents by argument.
            parameters: the parameters of this call, by the names that users know.
            threads: the number of threads for a batch.
        """
        if "grasp_wrench" in own_inputs(function, self.chain):
            inputs = *inputs[:-1], arrays.floats("grasp_wrench", inputs[-1], (len(self.chain.arms), 6))
        if function in HOLDING:
            require_holding(self.chain, inputs[-1])
        request, code = self._code_of(function, kind, of, by)
        found = code((*inputs, *(given[name] for name in request.given)), parameters, threads)
        if function == "inverse_dynamics":
            found = possible(self.chain, inputs[-1], found)
        result = result_of(function, self.chain, [found.pop(name) for name in DIFFERENTIABLE[function].results])
        parts: dict[Any, Any] = {name.removeprefix(FOUND): x for name, x in found.items()}
        if kind == "jacobian":
            names = [tuple(name.split(".")) for name in parts]
            parts = {(of, by): request.matrix(self.chain, of, by, parts[f"{of}.{by}"]) for of, by in names}
        return Derivatives(result, parts)

    def _vjp(
        self,
        function: str,
        inputs: Sequence[Any],
        cotangents: Mapping[str, Any],
        by: Sequence[str],
        parameters: Mapping[str, Any],
        threads: int,
    ) -> Derivatives:
        """Return gradients; of several cotangents, those that are None are left out."""
        given = {name: x for name, x in cotangents.items() if x is not None or len(cotangents) == 1}
        return self._derived(function, "vjp", inputs, tuple(given), by, given, parameters, threads)

    def _jvp(
        self, function: str, inputs: Sequence[Any], along: Any, parameters: Mapping[str, Any], threads: int
    ) -> Derivatives:
        """Return directional derivatives of all results."""
        checks.instance(along, Mapping, f"{function}_jvp: along", StateError)
        return self._derived(
            function, "jvp", inputs, DIFFERENTIABLE[function].results, along, along, parameters, threads
        )

    def bind_derivatives_of(
        self,
        function: str,
        kind: Kind,
        *,
        by: Collection[str],
        of: Sequence[str] | None = None,
        **inputs_or_parameters: Any,
    ) -> BoundFunctionDerivatives:
        """Return derivatives of a function besides forward dynamics bound to fixed arrays, for control loops.

        Args:
            function: its name: inverse_dynamics, kinetic_energy, potential_energy, closure, grasp_margins,
                joint_margins or wrist_wrenches.
            kind: `vjp`, `jvp` or `jacobian`, as in the methods `inverse_dynamics_vjp` and so on.
            by: the arguments by which it is differentiated.
            of: the results to differentiate; by default all.
            **inputs_or_parameters: initial values of the function's inputs, and its parameters.

        Raises:
            StateError: A name, shape or number is wrong.
        """
        for name, known, what in ((function, tuple(DIFFERENTIABLE), "function"), (kind, get_args(Kind), "kind")):
            if name not in known:
                what = f"bind_derivatives_of: {what}: expected one of {', '.join(known)}"
                raise StateError(f"{what}, got {checks.short(name)}.{checks.did_you_mean(str(name), known)}")
        request, code = self._code_of(function, kind, DIFFERENTIABLE[function].results if of is None else of, by)
        return BoundFunctionDerivatives(code, request, self.chain, inputs_or_parameters)

    def _code_of(
        self, function: str, kind: Kind, of: Sequence[str], by: Collection[str]
    ) -> tuple[FunctionRequest, CompiledFunction]:
        """Return the machine code of derivatives, made when first requested, after checking the names."""
        what, definition = f"{function}_{kind}", DIFFERENTIABLE[function]
        known = definition.arguments_at(self.chain, own_inputs(function, self.chain))
        require_names(what, of, definition.results)
        require_names(what, by, known)
        results = tuple(name for name in definition.results if name in of)
        request = FunctionRequest(kind, results, tuple(name for name in known if name in by), function)

        def make() -> CompiledFunction:
            options, shown_as = options_of(self.options, request.arguments, True), what if self.progress else ""
            return CompiledFunction(request.name, self.chain, options, request.computation(self.chain), shown_as)

        return request, self._code(request, what, make)
