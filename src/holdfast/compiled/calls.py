"""Call machine code with checked arrays, for one system or a batch, with the chain's own parameters or others."""

from __future__ import annotations

import ctypes
import threading
from array import array
from collections.abc import Mapping
from functools import cached_property

import numpy as np

from holdfast.compiled.arrays import Addresses
from holdfast.compiled.parameters import rank_number
from holdfast.compiled.result import ResultLayout, Results
from holdfast.compiler.kernel import Bound, Kernel
from holdfast.spatial.scalar import Array


class Calls:
    """Calls of a kernel whose results have a status. Calls from several threads may overlap.

    Attributes:
        kernel: the machine code.
        own: the chain's own values for arrays that a call does not give, by name.
        layout: the layout of the results.
    """

    def __init__(self, kernel: Kernel, own: Mapping[str, Array]) -> None:
        """Store the kernel and those of the chain's own values that the kernel reads."""
        self.kernel, self._bound, self._lock = kernel, kernel.bind(), threading.Lock()
        self.own = {name: x for name, x in self._bound.arrays.items() if name in own}
        self._bound.set({name: own[name] for name in self.own})
        self.layout = ResultLayout(kernel.externals)
        self._rank = [name for name in self.own if name == "generic_rank"]
        self._addresses = Addresses(kernel.externals, self.own)
        self._parameters = frozenset(name for name, e in kernel.externals.items() if e.role == "parameter")
        self._arena = int(self._bound.table[-1])
        self._run = ctypes.PYFUNCTYPE(ctypes.c_int64, ctypes.c_void_p)(kernel.single_address)
        self._changed: list[str] = []  # what the scratch arrays hold that is not the chain's own

    def __call__(self, found: Mapping[str, Array], result: Results, threads: int | None = None) -> bool:
        """Write the results of one system or a batch; return whether every status is OK.

        Args:
            found: the arrays of this call by name, float64 in C order.
            result: the result to be written; its batch size is that of the call.
            threads: as for `Function`.
        """
        if result.batch is not None:
            self.kernel.run_batch(self._addresses.table(found, result), result.batch, threads)
            return not self._rank or not result.array("status").any()
        row = self.row(found, result)
        if not self._parameters.isdisjoint(found):
            return self._apart(found, result)
        # This call holds the global interpreter lock, so no other thread uses the working memory meanwhile.
        table = array("q", row)  # of all kinds of arrays the quickest to make
        return self._run(table.buffer_info()[0]) == 0

    def row(self, found: Mapping[str, Array], result: Results) -> list[int]:
        """Return the addresses of all arrays and then of working memory, as the code for one system reads them."""
        return [*self._addresses.row(found, result), self._arena]

    def own_table(self) -> Array:
        """Return a table with the chain's own values for all arrays."""
        return np.array(self._bound.table)

    def set_rank(self, generic_rank: int | None) -> None:
        """Let statuses be decided by the chain's generic rank, if it is known."""
        self._bound.set({name: rank_number(generic_rank) for name in self._rank})

    def bind(self) -> Bound:
        """Return the kernel bound to new arrays, which hold the chain's own values."""
        bound = self.kernel.bind()
        bound.set(self.own)
        return bound

    def _apart(self, found: Mapping[str, Array], result: Results) -> bool:
        """Run one system with other parameters, in arrays that no other call uses."""
        with self._lock:
            scratch, own = self._scratch, self.own
            scratch.use({name: result.array(name) for name in self.layout.shapes})
            before = {name: own[name] for name in (*self._changed, *self._rank)}
            self._changed = [name for name in found if name in own]
            scratch.set(before | dict(found))
            return scratch.run() == 0

    @cached_property
    def _scratch(self) -> Bound:
        return self.bind()
