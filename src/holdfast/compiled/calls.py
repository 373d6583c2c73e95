"""Machine code called with checked arrays: one system, with the chain's own parameters or others, or a batch."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Mapping
from functools import cached_property

import numpy as np

from holdfast.compiled.arrays import Addresses
from holdfast.compiled.result import CompiledResult, ResultLayout
from holdfast.compiler.kernel import Bound, Kernel
from holdfast.spatial.scalar import Array


class Calls:
    """Calls of a kernel whose results have a status; from several threads they may overlap.

    Attributes:
        kernel: the machine code.
        own: what is not given, by name: numbers of the chain. After a change, `prepare`.
        layout: the results.
    """

    def __init__(self, kernel: Kernel, own: Mapping[str, Array]) -> None:
        """Take the kernel and the chain's own numbers; those that it does not take do not matter."""
        self.kernel, self._bound, self._lock = kernel, kernel.bind(), threading.Lock()
        self.own = {name: x for name, x in self._bound.arrays.items() if name in own}
        for name, x in self.own.items():
            x[...] = own[name]
        self.prepare()
        self.layout = ResultLayout(kernel.externals)
        self._addresses = Addresses(kernel.externals, self.own)
        self._run = ctypes.PYFUNCTYPE(ctypes.c_int64, ctypes.c_void_p)(kernel.single_address)

    def __call__(self, found: Mapping[str, Array], result: CompiledResult, threads: int = 1) -> bool:
        """Write the results of one system or a batch; return whether every status is OK.

        Args:
            found: what is given: float64, C order.
            result: where to; it says how many systems there are.
            threads: how many threads share a batch.
        """
        if result.batch is not None:
            self.kernel.run_batch(self._addresses.table(found, result), result.batch, threads)
            return not result.array("status").any()
        if any(self.kernel.externals[name].role == "parameter" for name in found):
            return self._apart(found, result)
        return self._run(self.table(found, result).ctypes.data) == 0  # holds Python's lock: no other call is under way

    def table(self, found: Mapping[str, Array], result: CompiledResult) -> Array:
        """Return all addresses and that of working memory, as the code of one system takes them."""
        return np.append(self._addresses.table(found, result)[:, 0], self._bound.table[-1])

    def own_table(self) -> Array:
        """Return the like of arrays that are the chain's own throughout."""
        return np.array(self._bound.table)

    def prepare(self) -> None:
        """Compute anew what follows from the chain's own numbers alone."""
        self._bound.prepare()

    def bind(self) -> Bound:
        """Return the code tied to arrays of its own, which hold the chain's numbers."""
        bound = self.kernel.bind()
        for name, x in self.own.items():
            bound.arrays[name][...] = x
        return bound

    def _apart(self, found: Mapping[str, Array], result: CompiledResult) -> bool:
        """Run one system with parameters of its own, apart from what other calls use."""
        with self._lock:
            self._spare.use({name: result.array(name) for name in self.layout.shapes})
            for name, x in (self.own | dict(found)).items():
                self._spare.arrays[name][...] = x
            self._spare.prepare()
            return self._spare.run() == 0

    @cached_property
    def _spare(self) -> Bound:
        return self.kernel.bind()
