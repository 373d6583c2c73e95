"""One computation of a chain as machine code, called with checked inputs for one system or a batch."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np

from holdfast.compiled import arrays
from holdfast.compiled.arm_functions import COMPUTATIONS, Computation
from holdfast.compiled.faults import fault, faulty, largest_positions
from holdfast.compiled.kernels import compile_batch, kernel
from holdfast.compiled.parameters import parameters_of, parse_parameters, require_inputs
from holdfast.compiled.structure import Options
from holdfast.compiler.kernel import Bound
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array


class CompiledFunction:
    """A compiled computation of one chain.

    Attributes:
        externals: the arrays that its machine code reads and writes, by name.
        parts: for every result with parts of arms, the slice of the last axis by arm name.
    """

    def __init__(
        self,
        name: str,
        chain: ClosedChain,
        options: Options,
        computation: Computation | None = None,
        shown_as: str = "",
    ) -> None:
        """Compile the computation, or load its machine code.

        Args:
            name: the name of the computation, which is looked up in `COMPUTATIONS` if `computation` is None.
            chain: the chain.
            options: the options with which the chain was compiled.
            computation: the computation. It must be defined in this package, whose source is part of the cache key.
            shown_as: what progress calls it while machine code for batches is made; without a name nothing is shown.
        """
        self._shown_as = shown_as
        self._chain, computation = chain, computation or COMPUTATIONS[name]
        structure = computation.structure(chain, options)
        self.externals = computation.externals(structure)
        self._kernel = kernel(name, structure, self.externals, lambda: computation.schedule(structure))
        self._inputs, self._by_name = computation.inputs, computation.by_name(chain)
        own = parameters_of(chain, None) | dict(computation.fixed)
        self._called = called = (*self._inputs, *self._by_name)
        self._own = {name: own[name] for name, e in self.externals.items() if e.role != "output" and name not in called}
        self._results = {name: e.shape for name, e in self.externals.items() if e.role == "output"}
        self._ranks = {name: len(e.shape) for name, e in self.externals.items()}
        self._largest = largest_positions(chain)
        self._unlimited = computation.unlimited
        self._lock = threading.Lock()
        self.parts: dict[str, dict[str, slice]] = {}
        for result in computation.results:
            ends = computation.starts(chain, result)
            spans = zip(chain.arms, ends, ends[1:], strict=False)
            self.parts[result] = {arm: slice(begin, end) for arm, begin, end in spans}

    def __call__(self, given: tuple[Any, ...], parameters: Mapping[str, Any], threads: int) -> dict[str, Array]:
        """Return the results by name, with a batch axis if anything given has one.

        Args:
            given: the inputs, in order.
            parameters: the run-time parameters of this call, by the names that users know.
            threads: the number of threads for a batch.

        Raises:
            StateError: A shape is wrong or a parameter is unknown; for a single system, also if a number is not
                finite, an angle exceeds 1e5 rad, a quaternion is not of unit length or a result overflows.
        """
        arrays.require_threads(threads)
        require_inputs(self._by_name, parameters)
        inputs, changed = self._parsed({**dict(zip(self._inputs, given, strict=True)), **parameters})
        batch = arrays.batch_of(inputs | changed, self.externals)
        if batch is not None:
            return self._many(inputs, changed, batch, threads)
        wrong = fault(inputs, self._largest)
        if wrong is not None:
            raise wrong
        return self._single(inputs, changed)

    def _parsed(self, given: Mapping[str, Any]) -> tuple[dict[str, Array], dict[str, Array]]:
        """Return the inputs and the parameters that are given, as the arrays that machine code reads."""
        inputs = {
            name: arrays.floats(name.rpartition(".")[2], given[name], self.externals[name].shape)
            for name in given
            if name in self._called
        }
        others = {name: x for name, x in given.items() if name not in inputs}
        return inputs, parse_parameters(others, self.externals, self._chain) if others else {}

    def _single(self, inputs: Mapping[str, Array], changed: Mapping[str, Array]) -> dict[str, Array]:
        """Run one system."""
        with self._lock:
            bound = self._spare if changed else self._bound
            if changed:
                bound.set(self._own | dict(changed))
            for name, x in inputs.items():
                bound.arrays[name][...] = x
            bound.run()
            return {name: self._required(bound.arrays[name].copy(), name) for name in self._results}

    def _required(self, x: Array, name: str) -> Array:
        """Return a result of one system; raise a StateError if it overflows."""
        checks.finite(np.where(np.isposinf(x), 0.0, x) if self._unlimited else x, name)
        return x

    def _many(
        self, inputs: Mapping[str, Array], changed: Mapping[str, Array], batch: int, threads: int
    ) -> dict[str, Array]:
        """Run a batch; the results of systems with an invalid input are NaN."""
        results = {name: np.empty((batch, *shape)) for name, shape in self._results.items()}
        found = self._own | {**inputs, **changed, **results}
        compile_batch(self._kernel, self._chain, self._shown_as, bool(self._shown_as))
        self._kernel.run_arrays(found, batch, threads)
        bad = faulty(inputs, self._ranks, self._largest, batch)
        if bad is not None:
            for x in results.values():
                x[bad] = np.nan
        return results

    def fill(self, bound: Bound, given: Mapping[str, Any]) -> None:
        """Write inputs and parameters of one system to the arrays of a bound kernel.

        Raises:
            StateError: A name is unknown, a shape is wrong or a parameter is not finite.
        """
        inputs, changed = self._parsed(given)
        found = inputs | changed
        for name, x in found.items():
            if x.ndim > self._ranks[name]:
                raise StateError(f"{name}: expected numbers of one system, got a batch of {len(x)}")
        bound.set(found)

    def bind(self) -> Bound:
        """Return the kernel bound to new arrays, which hold the chain's own parameters."""
        bound = self._kernel.bind()
        bound.set(self._own)
        return bound

    @cached_property
    def _bound(self) -> Bound:
        """The kernel with fixed arrays for single calls with the chain's own parameters."""
        return self.bind()

    @cached_property
    def _spare(self) -> Bound:
        """The kernel with fixed arrays for single calls with other parameters."""
        return self._kernel.bind()
