"""A compiled schedule tied to arrays of its own: the shortest way to call it, for control loops."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from typing import Any

import numpy as np

from holdfast.compiler import builtin
from holdfast.compiler.cpu import Code
from holdfast.compiler.schedule import External

_RUN = ctypes.PYFUNCTYPE(None, ctypes.c_void_p)


class Bound:
    """Write into `arrays`, call, read from `arrays`; for one thread at a time.

    Attributes:
        arrays: the inputs, parameters and outputs by name. After a change of parameters, `prepare`.
        memory: the one block in which they all lie.
        table: their addresses, then that of working memory.
        run: the call: computes, and returns the status (0: all is well).
    """

    def __init__(self, externals: Mapping[str, External], code: Code, arena: int) -> None:
        self._code = code  # alive as long as its address is used
        self.memory = aligned(sum(e.size for e in externals.values()))
        self._arena = aligned(arena)
        self.arrays: dict[str, np.ndarray] = {}
        self.table = np.empty(len(externals) + 1, dtype=np.int64)
        start = 0
        for k, (name, external) in enumerate(externals.items()):
            self.arrays[name] = self.memory[start : start + external.size].reshape(external.shape)
            self.table[k] = self.memory.ctypes.data + 8 * start
            start += external.size
        self.table[-1] = self._arena.ctypes.data
        self._prepare = _RUN(code.addresses["prepare"])
        self.run: Any = builtin.no_argument_call(code.addresses["single"], self.table, self)

    def use(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Tie some of the arrays to memory of the caller's: C order, float64, of the right shapes."""
        self.arrays |= arrays
        for k, name in enumerate(self.arrays):
            self.table[k] = self.arrays[name].ctypes.data

    def prepare(self) -> None:
        """Compute what depends on parameters only."""
        self._prepare(self.table.ctypes.data)


def aligned(count: int) -> np.ndarray:
    """Return zeros that begin at a cache line."""
    memory = np.zeros(count + 8)
    start = -(memory.ctypes.data // 8) % 8
    return memory[start : start + count]
