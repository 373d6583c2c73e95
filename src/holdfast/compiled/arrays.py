"""Check the user's arrays before their addresses are passed to machine code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from holdfast.compiled.result import CompiledResult
from holdfast.compiler.schedule import External
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.real_numbers import real_array
from holdfast.spatial.scalar import Array


def floats(name: str, value: Any, shape: tuple[int, ...]) -> Array:
    """Return a value as a float64 array in C order, of the given shape or with a leading batch axis."""
    if (
        type(value) is np.ndarray
        and value.dtype == np.float64
        and value.flags.c_contiguous
        and value.flags.aligned
        and value.shape[value.ndim - len(shape) :] == shape
        and value.ndim - len(shape) in (0, 1)
    ):
        return value
    a = real_array(value, name, "real numbers", StateError)
    if a.shape != shape and (a.ndim == 0 or a.shape[1:] != shape):
        raise StateError(f"{name}: expected shape {shape} or (batch, *{shape}), got {a.shape}")
    return np.require(a, np.float64, ["C", "A"])


def require_threads(threads: Any) -> None:
    """Raise a StateError unless `threads` is an integer of at least 1."""
    if not isinstance(threads, int) or isinstance(threads, bool) or threads < 1:
        raise StateError(f"threads: expected an integer >= 1, got {checks.short(threads)}")


def batch_of(found: Mapping[str, Array], externals: Mapping[str, External]) -> int | None:
    """Return the batch size of the arrays, or None if none of them has a batch axis.

    Raises:
        StateError: The arrays have different batch sizes.
    """
    batch: int | None = None
    for name, a in found.items():
        if a.ndim > len(externals[name].shape):
            if batch not in (None, len(a)):
                sizes = {n: len(x) for n, x in found.items() if x.ndim > len(externals[n].shape)}
                raise StateError(f"expected one batch size, got {', '.join(f'{n}: {s}' for n, s in sizes.items())}")
            batch = len(a)
    return batch


def require_fit(out: Any, chain: ClosedChain, batch: int | None, inputs: Sequence[Array]) -> None:
    """Raise a StateError if `out` belongs to another chain, has another batch size or shares memory with an input."""
    if not isinstance(out, CompiledResult) or out.chain is not chain:
        raise StateError(f"out: expected a result of this compiled chain, got {type(out).__name__}; leave it out first")
    if out.batch != batch:
        expected = "one system" if batch is None else f"a batch of {batch}"
        got = "one system" if out.batch is None else f"a batch of {out.batch}"
        raise StateError(f"out: expected a result of {expected}, got one of {got}")
    begin, end = out.address, out.address + out.memory.nbytes
    for a in inputs:
        if a.nbytes and a.ctypes.data < end and begin < a.ctypes.data + a.nbytes:
            raise StateError("out: expected memory of its own, but an input lies in it; try a copy of the input")


class Addresses:
    """Makes tables of the addresses of a kernel's arrays; the addresses of fixed arrays are stored once."""

    def __init__(self, externals: Mapping[str, External], fixed: Mapping[str, Array]) -> None:
        self._externals, self._fixed = externals, dict(fixed)  # keeps the memory of fixed arrays alive
        self._rows = {name: k for k, name in enumerate(externals)}
        self._template = np.zeros((len(externals), 2), dtype=np.int64)
        self._outputs = slice(len(externals) - sum(e.role == "output" for e in externals.values()), None)
        for name, a in fixed.items():
            self._template[self._rows[name]] = a.ctypes.data, 0

    def table(self, found: Mapping[str, Array], out: CompiledResult) -> Array:
        """Return the address and the stride of every array, (externals, 2), in the kernel's order.

        The stride is the number of doubles from one system to the next, or 0 if all systems share the array.

        Args:
            found: the inputs and those parameters that replace fixed ones, as float64 arrays in C order.
            out: the result to be written.
        """
        table = self._template.copy()
        for name, a in found.items():
            external = self._externals[name]
            table[self._rows[name]] = a.ctypes.data, external.size if a.ndim > len(external.shape) else 0
        count = 1 if out.batch is None else out.batch
        table[self._outputs, 0] = out.address + 8 * count * out.layout.starts
        table[self._outputs, 1] = out.layout.sizes
        return table
