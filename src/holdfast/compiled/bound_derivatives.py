"""Derivatives of forward dynamics tied to arrays that stay, for control loops."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from holdfast.compiled import arrays
from holdfast.compiled.bound_call import BoundCall
from holdfast.compiled.compiled_derivatives import CompiledDerivatives, Derivatives
from holdfast.compiled.derivative_schedule import WITH

if TYPE_CHECKING:
    from holdfast.compiled.chain import CompiledChain


class BoundDerivatives(BoundCall):
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
        super().__init__(compiled, code.calls)
        inputs = [name for name, e in code.externals.items() if e.role == "input"]
        self.arrays = {name: self._bound.arrays[name] for name in inputs if not name.startswith(WITH)}
        self.given = {name: self._bound.arrays[f"{WITH}{name}"] for name in code.request.given}
        self.found = Derivatives(self._written, code.request)
        for name, x in given.items():
            if name in inputs:
                self._bound.arrays[name][...] = arrays.floats(name.removeprefix(WITH), x, code.externals[name].shape)
        self.set(**{name: x for name, x in given.items() if name not in inputs})
