"""Derivatives of forward dynamics tied to arrays that stay, for control loops."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from holdfast.compiled import arrays, statuses
from holdfast.compiled.compiled_derivatives import CompiledDerivatives, Derivatives
from holdfast.compiled.derivative_schedule import WITH
from holdfast.compiled.parameters import parse_parameters
from holdfast.compiled.result import UNDECIDED, CompiledResult
from holdfast.dynamics.result import Status
from holdfast.errors import StateError

if TYPE_CHECKING:
    from holdfast.compiled.chain import CompiledChain


class BoundDerivatives:
    """Write into the inputs, call, read `found`; for one thread at a time.

    Nothing is checked and nothing is raised: the call returns the `Status`, and where that is SINGULAR or INVALID the
    derivatives are not-a-number.

    Attributes:
        arrays: the inputs by name, those of cotangents or tangents under their results' or arguments' names in
            `given`.
        given: what a product is taken with, by name.
        found: the last call's derivatives.
        run: the bare call without arguments: a number, 0 if the status is OK.
    """

    def __init__(self, compiled: CompiledChain, code: CompiledDerivatives, given: Mapping[str, Any]) -> None:
        self._compiled, self._code, self._bound = compiled, code, code.kernel.bind()
        for name, x in code.own.items():
            self._bound.arrays[name][...] = x
        inputs = [name for name, e in code.externals.items() if e.role == "input"]
        self.arrays = {name: self._bound.arrays[name] for name in inputs if not name.startswith(WITH)}
        self.given = {name: self._bound.arrays[f"{WITH}{name}"] for name in code.request.given}
        result = CompiledResult(compiled.chain, code.layout, None)
        self._bound.use({name: result.array(name) for name in code.layout.shapes})
        self.found = Derivatives(result, code.request)
        self.run = self._bound.run
        for name, x in given.items():
            if name in inputs:
                self._bound.arrays[name][...] = arrays.floats(name.removeprefix(WITH), x, code.externals[name].shape)
        self.set(**{name: x for name, x in given.items() if name not in inputs})

    def __call__(self) -> Status:
        """Compute `found` from the inputs."""
        code = self.run()
        if code == 0:
            return Status.OK
        if code == UNDECIDED:
            statuses.settle(self._compiled, self._bound.arrays, self.found.result)
            self._bound.arrays["generic_rank"][...] = float(self._compiled.generic_rank or 0)
            self._bound.prepare()
            self.run()
        return self.found.result.status

    def set(self, **parameters: Any) -> None:
        """Change run-time parameters, named as in `CompiledChain.forward_dynamics`.

        Raises:
            StateError: an unknown name, a wrong shape, a number that is not finite.
        """
        for name, x in parse_parameters(parameters, self._code.externals, self._compiled.chain).items():
            if x.ndim > len(self._code.externals[name].shape):
                raise StateError(f"set: {name}: expected numbers of one system, got a batch of {len(x)}")
            self._bound.arrays[name][...] = x
        self._bound.prepare()
