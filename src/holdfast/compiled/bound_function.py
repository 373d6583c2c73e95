"""Derivatives of functions that solve nothing, bound to fixed arrays, for control loops."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from holdfast.compiled.derivative_computation import FunctionRequest
from holdfast.compiled.derivative_schedule import FOUND, WITH
from holdfast.compiled.function import CompiledFunction
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import named, no_arguments
from holdfast.spatial.scalar import Array


class FoundDerivatives:
    """What a bound call found: `found.q` or `found["q"]`, of a Jacobian `found["tau", "q"]`.

    Attributes:
        results: the function's results by name; with a floating base or bushings, also what shows whether the arguments
            are possible: where they are not, the bound call computes derivatives all the same.
    """

    results: dict[str, Array]
    _chain: ClosedChain
    _request: FunctionRequest
    _parts: dict[str, Array]

    def __init__(self, chain: ClosedChain, request: FunctionRequest, outputs: Mapping[str, Array]) -> None:
        of_results = {name: x for name, x in outputs.items() if not name.startswith(FOUND)}
        parts = {name.removeprefix(FOUND): x for name, x in outputs.items() if name.startswith(FOUND)}
        self.__dict__.update(results=of_results, _chain=chain, _request=request, _parts=parts)

    def __getitem__(self, name: str | tuple[str, str]) -> Array:
        """Return the derivatives of one name; of a result by an argument, a new array of the Jacobian's entries."""
        if isinstance(name, str):
            return self._parts[name]
        of, by = name
        return self._request.matrix(self._chain, of, by, self._parts[f"{of}.{by}"])

    def __getattr__(self, name: str) -> Array:
        """Return the derivatives of one name."""
        parts = vars(self).get("_parts", {})
        if name not in parts:
            raise AttributeError(f"no derivative '{name}'; there are {', '.join(parts)}")
        return parts[name]


@named
class BoundFunctionDerivatives:
    """Derivatives of a function with fixed arrays: write into the inputs, call, read `found`. For one thread at a time.

    It checks nothing and raises nothing; where an input is invalid, results are NaN.

    Attributes:
        arrays: the function's inputs by name.
        given: the cotangents by result (of a `vjp`) or the tangents by argument (of a `jvp`).
        found: the derivatives of the last call, which the next one overwrites.
        run: the machine code as a function without arguments.
    """

    def __init__(
        self, code: CompiledFunction, request: FunctionRequest, chain: ClosedChain, given: Mapping[str, Any]
    ) -> None:
        self._code, self._bound = code, code.bind()
        arrays, roles = self._bound.arrays, {name: e.role for name, e in code.externals.items()}
        self.arrays = {name: x for name, x in arrays.items() if roles[name] == "input" and not name.startswith(WITH)}
        self.given = {name: arrays[f"{WITH}{name}"] for name in request.given}
        self.found = FoundDerivatives(
            chain, request, {name: x for name, x in arrays.items() if roles[name] == "output"}
        )
        self.run = self._bound.run
        self.set(**given)

    def __call__(self, *none: Any) -> None:
        """Compute the derivatives from the inputs."""
        if none:
            no_arguments("bound call", none)
        self.run()

    def set(self, **inputs_or_parameters: Any) -> None:
        """Change inputs or run-time parameters, named as in the function.

        Raises:
            StateError: A name is unknown, a shape is wrong or a number is not finite.
        """
        self._code.fill(self._bound, inputs_or_parameters)
