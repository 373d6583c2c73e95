"""Users' arrays, checked before their addresses reach machine code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from holdfast.compiled.result import CompiledResult
from holdfast.compiler.schedule import External
from holdfast.errors import StateError
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array


def floats(name: str, value: Any, shape: tuple[int, ...]) -> Array:
    """Return a value as a float64 array of a shape, or with a leading batch axis, C order."""
    try:
        a = np.asarray(value)
    except ValueError as cause:
        raise StateError(f"{name}: expected numbers of shape {shape} or (batch, *{shape}), got ragged rows") from cause
    if a.dtype.kind not in "fiub":
        raise StateError(f"{name}: expected real numbers, got {a.dtype}")
    if a.shape != shape and (a.ndim == 0 or a.shape[1:] != shape):
        raise StateError(f"{name}: expected shape {shape} or (batch, *{shape}), got {a.shape}")
    return np.require(a, np.float64, ["C", "A"])


def batch_of(found: Mapping[str, Array], externals: Mapping[str, External]) -> int | None:
    """Return how many systems the arrays hold; None if none of them has a batch axis.

    Raises:
        StateError: they disagree.
    """
    sizes = {name: len(a) for name, a in found.items() if a.ndim > len(externals[name].shape)}
    if len(set(sizes.values())) > 1:
        listed = ", ".join(f"{name}: {size}" for name, size in sizes.items())
        raise StateError(f"expected one batch size, got {listed}")
    return next(iter(sizes.values()), None)


def require_fit(out: Any, chain: ClosedChain, batch: int | None, inputs: Sequence[Array]) -> None:
    """Refuse a result that is not this chain's, of another batch size, or shares memory with an input."""
    if not isinstance(out, CompiledResult) or out.chain is not chain:
        raise StateError(f"out: expected a result of this compiled chain, got {type(out).__name__}; leave it out first")
    if out.batch != batch:
        expected = "one system" if batch is None else f"a batch of {batch}"
        got = "one system" if out.batch is None else f"a batch of {out.batch}"
        raise StateError(f"out: expected a result of {expected}, got one of {got}")
    begin, end = np.lib.array_utils.byte_bounds(out.memory) if out.memory.size else (0, 0)
    for a in inputs:
        if a.size:
            low, high = np.lib.array_utils.byte_bounds(a)
            if low < end and begin < high:
                raise StateError("out: expected memory of its own, but an input lies in it; try a copy of the input")


def table(externals: Mapping[str, External], found: Mapping[str, Array]) -> Array:
    """Return address and stride (0: shared by the batch) of every array, in the kernel's order."""
    rows = [
        (found[name].ctypes.data, e.size if found[name].ndim > len(e.shape) else 0) for name, e in externals.items()
    ]
    return np.array(rows, dtype=np.int64)
