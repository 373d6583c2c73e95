"""A program as a function of arrays: one system, or a batch in lanes and threads."""

from __future__ import annotations

import ctypes
import math
import threading
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Any

import numpy as np

from holdfast.compiler import arguments, cpu
from holdfast.compiler.bound import Bound
from holdfast.compiler.errors import CompileError
from holdfast.compiler.expand import lowered
from holdfast.compiler.llvm import batch_module, single_module
from holdfast.compiler.program import Program

Array = np.ndarray

# A call of this kind lets other Python threads run meanwhile.
_BATCH = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64, ctypes.c_int64)


def compile_program(program: Program, fused: bool = True, lanes: int | None = None) -> Kernel:
    """Return the program as machine code of this computer; code for batches is made when first needed.

    Args:
        program: what to compute.
        fused: whether products go into sums first (`fuse`).
        lanes: systems computed side by side in a batch; by default what a register holds.
    """
    return Kernel(lowered(program, fused), lanes or cpu.lanes())


class Kernel:
    """A compiled program; made by `compile_program`. Calls from several threads may overlap.

    Attributes:
        program: what it computes, instruction by instruction.
        lanes: systems computed side by side in a batch.
    """

    def __init__(self, program: Program, lanes: int) -> None:
        self.program, self.lanes = program, lanes
        self._code = cpu.Code(single_module(program), "single")
        self._private = threading.local()
        self._compiling = threading.Lock()

    def bind(self) -> Bound:
        """Return the program tied to arrays of its own, to be called without checks and copies."""
        return Bound(self.program, self._code)

    def __call__(self, *inputs: Any, out: tuple[Array, ...] | None = None, threads: int = 1) -> tuple[Array, ...]:
        """Return the results for one system, or for a batch.

        Args:
            inputs: an array of each input's shape; for a batch (batch, *shape), where an input of
                plain shape is shared by all systems.
            out: arrays to write the results to, C order float64, apart from each other and the inputs.
            threads: how many threads share the blocks of a batch. It does not change a bit.

        Raises:
            CompileError: saying which argument does not fit, and why.
        """
        shapes = self.program.input_shapes
        arrays, batch = (inputs, None) if arguments.fit(inputs, shapes) else arguments.checked(inputs, shapes)
        if out is not None:
            arguments.check_out(out, [o.shape for o in self.program.outputs], batch, arrays)
        if threads < 1:
            raise CompileError(f"kernel: threads: expected >= 1, got {threads}")
        return self._single(arrays, out) if batch is None else self._many(arrays, batch, out, threads)

    def _single(self, arrays: tuple[Array, ...], out: tuple[Array, ...] | None) -> tuple[Array, ...]:
        try:
            bound = self._private.bound
        except AttributeError:
            bound = self._private.bound = self.bind()
        for view, x in zip(bound.inputs, arrays, strict=True):
            view[...] = x
        bound()
        if out is None:
            return tuple([x.copy() for x in bound.outputs])
        for x, view in zip(out, bound.outputs, strict=True):
            x[...] = view
        return out

    @cached_property
    def _batch_code(self) -> cpu.Code:
        return cpu.Code(batch_module(self.program, self.lanes), "batch")

    def _many(
        self, arrays: tuple[Array, ...], batch: int, out: tuple[Array, ...] | None, threads: int
    ) -> tuple[Array, ...]:
        with self._compiling:
            run = _BATCH(self._batch_code.address)
        results = out or tuple(np.empty((batch, *o.shape)) for o in self.program.outputs)
        sizes = [math.prod(shape) for shape in self.program.input_shapes]
        rows = [
            (a.ctypes.data, size if a.ndim > len(shape) else 0)
            for a, size, shape in zip(arrays, sizes, self.program.input_shapes, strict=True)
        ]
        rows += [(r.ctypes.data, len(o.places)) for r, o in zip(results, self.program.outputs, strict=True)]
        table = np.array(rows, dtype=np.int64)
        blocks = -(-batch // self.lanes)
        threads = min(threads, max(1, blocks))
        if threads == 1:
            run(table.ctypes.data, 0, blocks, batch)
            return results
        bounds = [blocks * t // threads for t in range(threads + 1)]
        with ThreadPoolExecutor(threads) as pool:
            address = table.ctypes.data
            list(pool.map(lambda t: run(address, bounds[t], bounds[t + 1], batch), range(threads)))
        return results
