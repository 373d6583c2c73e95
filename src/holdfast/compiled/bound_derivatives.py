"""Derivatives of forward dynamics bound to fixed arrays, for control loops."""

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
    """Derivatives with fixed arrays: write into the inputs, call, read `found`. For one thread at a time.

    It checks nothing and raises nothing: the call returns the `Status`, and if that is SINGULAR or INVALID the
    derivatives are NaN.

    Attributes:
        arrays: the inputs of forward dynamics, by name.
        given: the cotangents by result (of a `vjp`) or the tangents by argument (of a `jvp`).
        found: the derivatives of the last call.
        run: the machine code as a function without arguments; it returns the status as an integer, 0 for OK.
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
