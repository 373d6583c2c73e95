"""A schedule compiled to machine code: for one system with fixed arrays, or for a batch, in lanes and threads.

The caller is responsible for the arrays: machine code uses their addresses unchecked.
"""

from __future__ import annotations

import ctypes
import threading
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from functools import cached_property
from typing import Any

import numpy as np

from holdfast.compiler.schedule import External, Schedule
from holdfast.compiler.targets import batch_module, cpu, foreign_call, no_argument_call, single_module
from holdfast.compiler.threads import divide

_BYTE = ctypes.c_char

_RUN = ctypes.PYFUNCTYPE(None, ctypes.c_void_p)

# A function of this type releases Python's global interpreter lock, so other threads run meanwhile.
_BATCH = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64, ctypes.c_int64, ctypes.c_int64, ctypes.c_void_p
)


class BatchKernel:
    """A schedule for batches, compiled at its first run. Calls from several threads may overlap.

    Attributes:
        externals: the arrays that it reads and writes, by name.
        lanes: how many systems are computed side by side.
    """

    def __init__(
        self,
        externals: Mapping[str, External],
        make: Callable[[], Schedule],
        key: str = "",
        lanes: int | None = None,
        quick: bool = False,
        shown: Callable[[], AbstractContextManager[object]] = nullcontext,
    ) -> None:
        """Prepare to compile a schedule; nothing is compiled yet.

        Args:
            externals: the external arrays of the schedule, by name.
            make: returns the schedule; it is not called if the machine code is in the cache on disk.
            key: identifies the schedule in the cache; without a key, its source code identifies it.
            lanes: how many systems are computed side by side; by default as many as fit a vector register.
            quick: whether to spend less time on optimisation, for code that will not run for long. The results are
                the same bit for bit.
            shown: returns the context within which to compile, which shows it to people.
        """
        self._quick, self._shown = quick, shown
        self.externals, self.lanes = externals, lanes or cpu.lanes()
        self._make, self._key = make, f"{key}/{self.lanes}" if key else ""
        self._compiling = threading.Lock()
        self._idle: deque[np.ndarray] = deque()  # working memory of earlier calls, reused because allocating it is slow

    @cached_property
    def schedule(self) -> Schedule:
        """The schedule, made when first needed."""
        return self._make()

    def run_batch(self, table: np.ndarray, batch: int, threads: int | None = None, repeats: int = 1) -> None:
        """Run a batch; the caller is responsible for the addresses.

        Args:
            table: (externals, 2) address and stride in doubles of each array, in order.
            batch: the number of systems.
            threads: the number of threads among which the systems are divided; see `divide`.
            repeats: how many times each system is run, for a schedule with carried arrays.
        """
        with self._compiling:
            code = self._batch_code
        run, address = _BATCH(code.address), table.ctypes.data

        def part(begin: int, end: int) -> None:
            try:
                arena = self._idle.pop()
            except IndexError:
                arena = aligned(code.notes["arena"])
            run(address, begin, end, batch, repeats, arena.ctypes.data)
            self._idle.append(arena)

        divide(part, -(-batch // self.lanes), code.notes["operations"] * repeats, threads)

    def repeatedly(self, batch: int) -> Callable[[int], None]:
        """Return a function that runs a batch on this thread, for the table at a given address; see `run_batch`."""
        with self._compiling:
            code = self._batch_code
        run, blocks = _BATCH(code.address), -(-batch // self.lanes)
        arena = aligned(code.notes["arena"]).ctypes.data_as(ctypes.c_void_p)  # which keeps the memory

        def run_table(table: int) -> None:
            run(table, 0, blocks, batch, 1, arena)

        return run_table

    def run_arrays(self, arrays: Mapping[str, np.ndarray], batch: int, threads: int | None = None) -> None:
        """Run a batch on float64 arrays in C order, (batch, *shape) each, or (*shape) if all systems share it.

        Args:
            arrays: the external arrays by name.
            batch: the number of systems.
            threads: as for `run_batch`.
        """
        table = np.zeros((len(self.externals), 2), dtype=np.int64)
        for row, (name, external) in zip(table, self.externals.items(), strict=True):
            x, shape = arrays[name], external.shape
            assert x.shape in (shape, (batch, *shape)), "machine code would read beyond an array's end"
            row[:] = address_of(x), external.size if x.ndim > len(shape) else 0
        self.run_batch(table, batch, threads)

    @property
    def batch_is_compiled(self) -> bool:
        """Whether there is machine code for batches."""
        return "_batch_code" in vars(self)

    def compile_batch(self) -> None:
        """Compile the machine code for batches now, rather than at their first run."""
        with self._compiling:
            _ = self._batch_code

    @cached_property
    def _batch_code(self) -> cpu.Code:
        with self._shown():
            return cpu.Code(self._batch_source, "batch", key=self._key and f"{self._key}/batch", quick=self._quick)

    def _batch_source(self) -> tuple[str, cpu.Notes]:
        text, arena = batch_module(self.schedule, self.lanes)
        return text, {"arena": arena, "operations": self.schedule.operation_count}


class Kernel(BatchKernel):
    """A compiled schedule, for one system and for batches. Calls from several threads may overlap.

    Attributes:
        externals: the arrays that it reads and writes, by name.
        lanes: how many systems of a batch are computed side by side.
    """

    def __init__(
        self,
        externals: Mapping[str, External],
        make: Callable[[], Schedule],
        key: str = "",
        lanes: int | None = None,
    ) -> None:
        """Compile the schedule for one system, or load its machine code from the cache.

        Args:
            externals: the external arrays of the schedule, by name.
            make: returns the schedule; it is not called if the machine code is in the cache on disk.
            key: identifies the schedule in the cache; without a key, its source code identifies it.
            lanes: how many items of one system, or systems of a batch, are computed side by side.
        """
        super().__init__(externals, make, key, lanes)
        self._code = cpu.Code(self._single_source, "single", "prepare", key=self._key and f"{self._key}/single")

    @property
    def operation_count(self) -> int:
        """The number of arithmetic operations for one system."""
        return self._code.notes["operations"]

    @property
    def single_address(self) -> int:
        """The address of the function that runs one system; it takes a table of addresses (`targets.single_module`)."""
        return self._code.address

    def bind(self) -> Bound:
        """Return the kernel bound to arrays of its own, to be called without checks and copies."""
        return Bound(self.externals, self._code, self._code.notes["arena"])

    def publish(self, status: str, open_status: float) -> int:
        """Register the kernel so that code of other compilers, such as XLA, can call it; return its key.

        Args:
            status: the output that says whether a system has a solution.
            open_status: the status of a system that is undecided; its results become NaN.
        """
        assert self._key, "a kernel without a key cannot be named by other processes"
        with self._compiling:
            batch = self._batch_code
        return foreign_call.publish(self._key, self._code, batch, self.lanes, self.externals, status, open_status)

    def _single_source(self) -> tuple[str, cpu.Notes]:
        text, arena = single_module(self.schedule, self.lanes)
        return text, {"arena": arena, "operations": self.schedule.operation_count}


class Bound:
    """A kernel with fixed arrays: write into `arrays`, call `run`, read from `arrays`. For one thread at a time.

    Attributes:
        arrays: the inputs, parameters and outputs by name. Call `prepare` after changing a parameter.
        memory: the block of memory that holds all of them.
        table: their addresses, then that of the working memory.
        run: runs the kernel and returns the status, which is 0 if there was no problem.
    """

    def __init__(self, externals: Mapping[str, External], code: cpu.Code, arena: int) -> None:
        self._code = code  # keeps the machine code alive while its address is in use
        self.memory = aligned(sum(e.size for e in externals.values()))
        self._arena = aligned(arena)
        self.arrays: dict[str, np.ndarray] = {}
        self._places = {name: k for k, name in enumerate(externals)}
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
        """Use the caller's memory for some of the arrays; it must be float64 in C order, of the right shapes."""
        self.arrays |= arrays
        for name, x in arrays.items():
            self.table[self._places[name]] = address_of(x)

    def set(self, values: Mapping[str, np.ndarray]) -> None:
        """Write numbers into some of the arrays, and compute what depends on parameters only."""
        for name, x in values.items():
            self.arrays[name][...] = x
        self.prepare()

    def prepare(self) -> None:
        """Compute what depends on parameters only."""
        self._prepare(self.table.ctypes.data)


def address_of(x: np.ndarray) -> int:
    """Return `x.ctypes.data`, in a quarter of the time if the array is writable."""
    try:
        return ctypes.addressof(_BYTE.from_buffer(x))  # type: ignore[arg-type]  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError):  # read-only, or without entries
        return x.ctypes.data


def aligned(count: int, made: Callable[[int], np.ndarray] = np.zeros) -> np.ndarray:
    """Return `count` zeros, or what else `made` returns, whose memory begins at a cache line."""
    memory = made(count + 8)
    start = -(memory.ctypes.data // 8) % 8
    return memory[start : start + count]
