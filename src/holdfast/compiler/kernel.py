"""A schedule as a function of arrays: one system, a batch in lanes and threads, or tied to arrays that stay."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Any

import numpy as np

from holdfast.compiler.errors import CompileError
from holdfast.compiler.lowering import lowered
from holdfast.compiler.program import Program, Shape
from holdfast.compiler.schedule import External, Schedule, schedule_of
from holdfast.compiler.targets import batch_module, cpu, no_argument_call, single_module

Array = np.ndarray

_FLOAT64 = np.dtype(np.float64)
_RUN = ctypes.PYFUNCTYPE(None, ctypes.c_void_p)

# A call of this kind lets other Python threads run meanwhile.
_BATCH = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64, ctypes.c_int64, ctypes.c_int64, ctypes.c_void_p
)


def compile_program(program: Program, fused: bool = True, lanes: int | None = None) -> Kernel:
    """Return a program as machine code of this computer; code for batches is made when first needed.

    Args:
        program: what to compute.
        fused: whether products go into sums first (`fuse`).
        lanes: systems computed side by side in a batch; by default what a register holds.
    """
    schedule = schedule_of(lowered(program, fused))
    return Kernel(schedule.externals, lambda: schedule, lanes=lanes)


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
        self._given = {name: e for name, e in externals.items() if e.role != "output"}
        self._returned = {name: e for name, e in externals.items() if e.role == "output"}
        self._code = cpu.Code(self._single_source, "single", "prepare", key=self._key and f"{self._key}/single")
        self._private = threading.local()

    @property
    def operation_count(self) -> int:
        """Arithmetic operations of one system."""
        return self._code.notes["operations"]

    @property
    def single_address(self) -> int:
        """The function that runs one system from a table of addresses, as in `single_entry`."""
        return self._code.address

    def bind(self) -> Bound:
        """Return the kernel tied to arrays of its own, to be called without checks and copies."""
        return Bound(self.externals, self._code, self._code.notes["arena"])

    def __call__(self, *inputs: Any, out: tuple[Array, ...] | None = None, threads: int = 1) -> tuple[Array, ...]:
        """Return the results for one system, or for a batch.

        Args:
            inputs: an array of each input's shape, then of each parameter's; for a batch
                (batch, *shape), where an array of plain shape is shared by all systems.
            out: arrays to write the results to, C order float64, apart from each other and the inputs.
            threads: how many threads share the blocks of a batch. It does not change a bit.

        Raises:
            CompileError: saying which argument does not fit, and why.
        """
        shapes = tuple(e.shape for e in self._given.values())
        arrays, batch = (inputs, None) if _fit(inputs, shapes) else _checked(inputs, shapes)
        if out is not None:
            _check_out(out, [e.shape for e in self._returned.values()], batch, arrays)
        if threads < 1:
            raise CompileError(f"kernel: threads: expected >= 1, got {threads}")
        return self._single(arrays, out) if batch is None else self._many(arrays, batch, out, threads)

    def _single(self, arrays: tuple[Array, ...], out: tuple[Array, ...] | None) -> tuple[Array, ...]:
        try:
            bound = self._private.bound
        except AttributeError:
            bound = self._private.bound = self.bind()
        for name, x in zip(self._given, arrays, strict=True):
            bound.arrays[name][...] = x
        bound.prepare()
        bound.run()
        found = [bound.arrays[name] for name in self._returned]
        if out is None:
            return tuple([x.copy() for x in found])
        for x, view in zip(out, found, strict=True):
            x[...] = view
        return out

    def _many(
        self, arrays: tuple[Array, ...], batch: int, out: tuple[Array, ...] | None, threads: int
    ) -> tuple[Array, ...]:
        results = out or tuple(np.empty((batch, *e.shape)) for e in self._returned.values())
        rows = [
            (a.ctypes.data, e.size if a.ndim > len(e.shape) else 0)
            for a, e in zip(arrays, self._given.values(), strict=True)
        ]
        rows += [(r.ctypes.data, e.size) for r, e in zip(results, self._returned.values(), strict=True)]
        order = [*self._given, *self._returned]
        self.run_batch(np.array([rows[order.index(name)] for name in self.externals], dtype=np.int64), batch, threads)
        return results

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


def _fit(inputs: Sequence[Any], shapes: tuple[Shape, ...]) -> bool:
    """Return whether the inputs are one system's float64 arrays as they stand; quick, and most calls are so."""
    if len(inputs) != len(shapes):
        return False
    for x, shape in zip(inputs, shapes, strict=True):
        if type(x) is not np.ndarray or x.shape != shape or x.dtype is not _FLOAT64:
            return False
    return True


def _checked(inputs: Sequence[Any], shapes: tuple[Shape, ...]) -> tuple[tuple[np.ndarray, ...], int | None]:
    """Return the inputs as float64 arrays, and how many systems they hold (None: one, without a batch axis)."""
    if len(inputs) != len(shapes):
        raise CompileError(f"kernel: expected {len(shapes)} inputs, of shapes {_listed(shapes)}, got {len(inputs)}")
    arrays = tuple(_floats(k, x) for k, x in enumerate(inputs))
    batch: int | None = None
    for k, (a, shape) in enumerate(zip(arrays, shapes, strict=True)):
        if a.shape == shape:
            continue
        if a.ndim == 0 or a.shape[1:] != shape:
            raise CompileError(f"kernel: input {k}: expected shape {shape} or (batch, *{shape}), got {a.shape}")
        if batch not in (None, len(a)):
            raise CompileError(f"kernel: input {k}: expected {batch} systems as in the inputs before, got {len(a)}")
        batch = len(a)
    return arrays, batch


def _check_out(out: Any, shapes: Sequence[Shape], batch: int | None, inputs: Sequence[np.ndarray]) -> None:
    """Refuse results' arrays that do not fit, or share memory with each other or with an input."""
    full = [shape if batch is None else (batch, *shape) for shape in shapes]
    if not isinstance(out, tuple) or len(out) != len(full):
        raise CompileError(f"kernel: out: expected a tuple of {len(full)} arrays, of shapes {_listed(full)}")
    for k, (a, shape) in enumerate(zip(out, full, strict=True)):
        if not isinstance(a, np.ndarray) or a.dtype != np.float64 or a.shape != shape:
            got = f"{a.dtype} of shape {a.shape}" if isinstance(a, np.ndarray) else type(a).__name__
            raise CompileError(f"kernel: out {k}: expected float64 of shape {shape}, got {got}")
        if not (a.flags.c_contiguous and a.flags.writeable and a.flags.aligned):
            raise CompileError(f"kernel: out {k}: expected a writable array in C order; try np.empty({shape})")
        if any(np.may_share_memory(a, b) for b in (*inputs, *out[:k])):
            raise CompileError(f"kernel: out {k}: expected memory of its own, got some of an input or another result")


def _floats(k: int, x: Any) -> np.ndarray:
    if isinstance(x, np.ndarray) and hasattr(x, "mask"):
        raise CompileError(f"kernel: input {k}: expected real numbers, got a masked array")
    a = np.asarray(x)
    if a.dtype.kind not in "fiub":
        raise CompileError(f"kernel: input {k}: expected real numbers, got {a.dtype}")
    return np.require(a, np.float64, ["C", "A"])


def _listed(shapes: Sequence[Shape]) -> str:
    return ", ".join(str(shape) for shape in shapes) or "none"
