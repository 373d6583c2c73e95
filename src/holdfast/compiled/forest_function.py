"""Questions of a forest, or of a chain that is answered as one, as functions of arrays in machine code."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from holdfast.compiled import arrays
from holdfast.compiled.calls import Calls
from holdfast.compiled.computation import Computation
from holdfast.compiled.derivative_schedule import WITH
from holdfast.compiled.derivatives import CompiledDerivatives
from holdfast.compiled.forest_request import ForestRequest
from holdfast.compiled.forest_schedule import forward_outputs, traced_solution
from holdfast.compiled.forest_terms import ForestTerms
from holdfast.compiled.kernels import compiling, kernel
from holdfast.compiled.traced_chain import Given, externals, traced
from holdfast.compiler.schedule import FIRST_BAD, Schedule
from holdfast.errors import StateError
from holdfast.spatial.scalar import Array


class ForestFunction:
    """A question of a forest as machine code for one system or a batch, or bound to fixed arrays.

    This one is forward dynamics, or derivatives of it.

    Attributes:
        terms: the arrays that it takes and returns.
        request: the derivatives that are computed; None for the answer alone.
        externals: the arrays that the machine code reads and writes, by name.
        progress: whether to show that machine code is made; see `holdfast.compile`.
    """

    has_status = True  # what a `BoundFunction` asks of a function
    question: ClassVar[str] = "forward_dynamics"
    of_status: ClassVar[tuple[str, ...]] = ("rank", "status", "condition")

    def __init__(
        self, terms: ForestTerms, key: str, progress: bool | None, request: ForestRequest | None = None
    ) -> None:
        self.terms, self.chain, self.progress, self.request, self._key = terms, terms.subject, progress, request, key
        self.key = key if request is None else f"{key}/{request.name}"
        given = {} if request is None else request.given(terms)
        found = {} if request is None else request.found(terms)
        shapes = {
            **terms.inputs,
            **given,
            **terms.further,
            **terms.outputs,
            **dict.fromkeys(self.of_status, ()),
            **found,
        }
        inputs, outputs = [*terms.inputs, *given, *terms.further], [*terms.outputs, *self.of_status, *found]
        self.externals, self._needed = externals(inputs, [], outputs, shapes), [*terms.inputs, *given]

    def of(self, request: ForestRequest) -> ForestFunction:
        """Return the function of some derivatives."""
        return ForestFunction(self.terms, self._key, self.progress, request)

    @property
    def name(self) -> str:
        """The name of the question, with the kind of derivatives if these are computed."""
        return self.question if self.request is None else f"{self.question}.{self.request.kind}"

    def __call__(self, given: Mapping[str, Any], out: Any, threads: int | None) -> Any:
        """Return accelerations and forces of one system or a batch.

        Args:
            given: the arrays by name; those of `terms.further` are zero by default.
            out: an earlier result, to be overwritten.
            threads: how many threads share a batch; None: as many as make it faster.

        Raises:
            StateError, SingularChainError, ModelError: as the reference raises them.
        """
        arrays.require_threads(threads)
        present = {name: x for name, x in given.items() if x is not None}
        if lacking := [name for name in self._needed if name not in present]:
            raise StateError(f"{self.name}: expected {', '.join(self._needed)}, got no {' and no '.join(lacking)}")
        if unknown := [name for name in present if name not in self.externals]:
            raise StateError(f"{unknown[0]}: expected none; try holdfast.compile(..., parameters=['link_wrench'])")
        shapes = {name: self.externals[name].shape for name in present}
        found = {name: arrays.floats(name.removeprefix(WITH), x, shapes[name]) for name, x in present.items()}
        self.terms.require(found)
        batch = arrays.batch_of(found, self.externals)
        if (out.request if isinstance(out, CompiledDerivatives) else None) != self.request and out is not None:
            raise StateError("out: expected earlier derivatives of the same names; leave it out first")
        result = out.results if isinstance(out, CompiledDerivatives) else out
        if result is None:
            result = self.results(batch)
        else:
            arrays.require_fit(result, self.chain, batch)
        if batch is not None and not self.calls.kernel.batch_is_compiled:
            with compiling(self.chain, f"{self.name} for batches", self.progress):
                self.calls.kernel.compile_batch()
        self.calls(found, result, threads)
        if batch is None and result.array("status") >= FIRST_BAD:
            self._refuse(found)
        if self.request is None:
            return result
        self.request.settle(self.terms, result)
        return self.shown(result) if out is None else out

    @cached_property
    def calls(self) -> Calls:
        """The calls of the machine code, which is made or loaded when they are first needed."""
        with compiling(self.chain, self.name, self.progress):
            structure: Any = self  # whose key names the code
            code = kernel(Computation("forest", structure, self.externals, self.schedule, tuple(self._needed)))
        return Calls(code, {name: np.zeros(shape) for name, shape in self.terms.further.items()})

    def schedule(self) -> Schedule:
        """Return the schedule, made by tracing the reference's functions."""
        guarded = [*self.terms.outputs, *(() if self.request is None else self.request.found(self.terms))]
        return traced(self.externals, self.traced_outputs, "status", tuple(guarded))

    def traced_outputs(self, given: Given) -> dict[str, Any]:
        """Return the outputs by name of the traced arrays."""
        terms, request = self.terms, self.request
        solved = traced_solution(terms.forest, terms.arguments(given))
        found = forward_outputs(solved)
        own = terms.results(found) | {name: found[name] for name in self.of_status}
        return own if request is None else own | request.outputs(terms, solved, given)

    def results(self, batch: int | None) -> Any:
        """Return new memory for the results of one system, or of a batch."""
        return self.terms.made(self.chain, self.calls.layout, batch)

    def shown(self, results: Any) -> Any:
        """Return what a user gets of the results in memory."""
        return results if self.request is None else CompiledDerivatives(self.request, results)

    def only_array(self, results: Any) -> None:
        """Return None, as there are several results."""

    @property
    def subject(self) -> str:
        """What it is about, for descriptions."""
        return repr(self.chain)

    def _refuse(self, found: Mapping[str, Array]) -> None:
        """Raise the error of the reference for one system without an answer."""
        for name, x in found.items():
            if not np.isfinite(x).all():
                raise StateError(f"{name}: expected finite numbers, got {x[~np.isfinite(x)][0]}")
        self.terms.refuse(found)
        worst = float(np.abs(found["q"]).max())
        raise StateError(f"q: expected angles of at most {arrays.LARGEST_ARGUMENT:g} rad, got {worst:.6g}")
