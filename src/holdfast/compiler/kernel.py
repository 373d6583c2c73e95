"""A schedule as a function of arrays: one system, or a batch in lanes and threads."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from holdfast.compiler import arguments, cpu
from holdfast.compiler.batch_kernel import BatchKernel
from holdfast.compiler.bound import Bound
from holdfast.compiler.errors import CompileError
from holdfast.compiler.expand import lowered
from holdfast.compiler.program import Program
from holdfast.compiler.program_schedule import schedule_of
from holdfast.compiler.schedule import External, Schedule
from holdfast.compiler.single_entry import single_module

Array = np.ndarray


def compile_program(program: Program, fused: bool = True, lanes: int | None = None) -> Kernel:
    """Return a program as machine code of this computer; code for batches is made when first needed.

    Args:
        program: what to compute.
        fused: whether products go into sums first (`fuse`).
        lanes: systems computed side by side in a batch; by default what a register holds.
    """
    schedule = schedule_of(lowered(program, fused))
    return Kernel(schedule.externals, lambda: schedule, lanes=lanes)


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
            key: stands for the schedule there; without it, its text does.
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
        arrays, batch = (inputs, None) if arguments.fit(inputs, shapes) else arguments.checked(inputs, shapes)
        if out is not None:
            arguments.check_out(out, [e.shape for e in self._returned.values()], batch, arrays)
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
