"""Which arrays a kernel takes, checked before their addresses reach machine code."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from holdfast.compiler.errors import CompileError
from holdfast.compiler.program import Shape

_FLOAT64 = np.dtype(np.float64)


def fit(inputs: Sequence[Any], shapes: tuple[Shape, ...]) -> bool:
    """Return whether the inputs are one system's float64 arrays as they stand; quick, and most calls are so."""
    if len(inputs) != len(shapes):
        return False
    for x, shape in zip(inputs, shapes, strict=True):
        if type(x) is not np.ndarray or x.shape != shape or x.dtype is not _FLOAT64:
            return False
    return True


def checked(inputs: Sequence[Any], shapes: tuple[Shape, ...]) -> tuple[tuple[np.ndarray, ...], int | None]:
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


def check_out(out: Any, shapes: Sequence[Shape], batch: int | None, inputs: Sequence[np.ndarray]) -> None:
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
