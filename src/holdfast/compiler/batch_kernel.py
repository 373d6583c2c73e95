"""A schedule as a function of arrays of many systems: in lanes, and in threads."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property

import numpy as np

from holdfast.compiler import cpu
from holdfast.compiler.batch_entry import batch_module
from holdfast.compiler.bound import aligned
from holdfast.compiler.schedule import External, Schedule

Array = np.ndarray

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
            key: stands for the schedule there; without it, its text does.
            lanes: items or systems computed side by side.
            quick: compile sooner what will not run for long; the bits are the same.
        """
        self._quick = quick
        self.externals, self.lanes = externals, lanes or cpu.lanes()
        self._make, self._key = make, f"{key}/{self.lanes}" if key else ""
        self._compiling = threading.Lock()

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
            arena = aligned(code.notes["arena"])
            run(address, bounds[t], bounds[t + 1], batch, repeats, arena.ctypes.data)

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
