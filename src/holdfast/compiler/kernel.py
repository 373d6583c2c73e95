"""A schedule as machine code: for one system, tied to arrays that stay; for a batch, in lanes and threads.

Who calls it vouches for the arrays: addresses reach machine code unchecked.
"""

from __future__ import annotations

import ctypes
import threading
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Any

import numpy as np

from holdfast.compiler.schedule import External, Schedule
from holdfast.compiler.targets import batch_module, cpu, foreign_call, no_argument_call, single_module

Array = np.ndarray

_RUN = ctypes.PYFUNCTYPE(None, ctypes.c_void_p)

# A call of this kind lets other Python threads run meanwhile.
_BATCH = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64, ctypes.c_int64, ctypes.c_int64, ctypes.c_void_p
)


class BatchKernel:
    """A schedule compiled for batches when first run. Calls from several threads may overlap.

    Attributes:
        externals: the arrays it takes and returns.
        lanes: systems computed side by side.
    """

    def __init__(
        self,
        externals: Mapping[str, External],
        make: Callable[[], Schedule],
        key: str = "",
        lanes: int | None = None,
        quick: bool = False,
    ) -> None:
        """Take what is to be compiled.

        Args:
            externals: the schedule's.
            make: returns the schedule; not called if the machine code is on disk.
            key: stands for the schedule there; without it, its source does.
            lanes: items or systems computed side by side.
            quick: compile sooner what will not run for long; the bits are the same.
        """
        self._quick = quick
        self.externals, self.lanes = externals, lanes or cpu.lanes()
        self._make, self._key = make, f"{key}/{self.lanes}" if key else ""
        self._compiling = threading.Lock()
        self._idle: deque[Array] = deque()  # working memory of earlier calls: to make it anew is slow

    @cached_property
    def schedule(self) -> Schedule:
        """What it computes, stage by stage."""
        return self._make()

    def run_batch(self, table: Array, batch: int, threads: int = 1, repeats: int = 1) -> None:
        """Run a batch; the caller vouches for the addresses.

        Args:
            table: (externals, 2) address and stride in doubles of each array, in order.
            batch: how many systems.
            threads: how many threads share their blocks.
            repeats: how many times each system is run, if the schedule carries arrays on.
        """
        with self._compiling:
            code = self._batch_code
        run, address = _BATCH(code.address), table.ctypes.data
        blocks = -(-batch // self.lanes)
        threads = min(threads, max(1, blocks))
        bounds = [blocks * t // threads for t in range(threads + 1)]

        def part(t: int) -> None:
            try:
                arena = self._idle.pop()
            except IndexError:
                arena = aligned(code.notes["arena"])
            run(address, bounds[t], bounds[t + 1], batch, repeats, arena.ctypes.data)
            self._idle.append(arena)

        if threads == 1:
            part(0)
            return
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(part, range(threads)))

    @cached_property
    def _batch_code(self) -> cpu.Code:
        return cpu.Code(self._batch_source, "batch", key=self._key and f"{self._key}/batch", quick=self._quick)

    def _batch_source(self) -> tuple[str, cpu.Notes]:
        text, arena = batch_module(self.schedule, self.lanes)
        return text, {"arena": arena}


class Kernel(BatchKernel):
    """A compiled schedule. Calls from several threads may overlap.

    Attributes:
        externals: the arrays it takes and returns.
        lanes: systems computed side by side in a batch.
    """

    def __init__(
        self,
        externals: Mapping[str, External],
        make: Callable[[], Schedule],
        key: str = "",
        lanes: int | None = None,
    ) -> None:
        """Compile, or load what an earlier run compiled.

        Args:
            externals: the schedule's.
            make: returns the schedule; not called if the machine code is on disk.
            key: stands for the schedule there; without it, its source does.
            lanes: items or systems computed side by side.
        """
        super().__init__(externals, make, key, lanes)
        self._code = cpu.Code(self._single_source, "single", "prepare", key=self._key and f"{self._key}/single")

    @property
    def operation_count(self) -> int:
        """Arithmetic operations of one system."""
        return self._code.notes["operations"]

    @property
    def single_address(self) -> int:
        """The function that runs one system from a table of addresses, as in `targets.single_module`."""
        return self._code.address

    def bind(self) -> Bound:
        """Return the kernel tied to arrays of its own, to be called without checks and copies."""
        return Bound(self.externals, self._code, self._code.notes["arena"])

    def publish(self, status: str, open_status: float) -> int:
        """Let other compilers' programs call the kernel, from now on; return the key by which they name it.

        Args:
            status: the array that says whether a system has an answer.
            open_status: a status that is not decided: such a system's results become not-a-number.
        """
        assert self._key, "what has no key has no name in other processes"
        with self._compiling:
            codes = foreign_call.Codes(self._code, self._batch_code, self.lanes)
        return foreign_call.publish(self._key, codes, self.externals, status, open_status)

    def _single_source(self) -> tuple[str, cpu.Notes]:
        text, arena = single_module(self.schedule, self.lanes)
        return text, {"arena": arena, "operations": self.schedule.operation_count}


class Bound:
    """Write into `arrays`, call, read from `arrays`; for one thread at a time.

    Attributes:
        arrays: the inputs, parameters and outputs by name. After a change of parameters, `prepare`.
        memory: the one block in which they all lie.
        table: their addresses, then that of working memory.
        run: the call: computes, and returns the status (0: all is well).
    """

    def __init__(self, externals: Mapping[str, External], code: cpu.Code, arena: int) -> None:
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
        self.run: Any = no_argument_call(code.addresses["single"], self.table, self)

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
