"""Kernels as functions that XLA's programs, such as those of JAX, call on this processor.

One handler serves all kernels. A program selects its kernel by the attribute `key`, a number that is the same in every
process. A program that was stored on disk, where an address would be invalid, can therefore find its kernel again, or
reports that the kernel is not in this process. Published kernels are never freed, because XLA does not tell when it
discards the last program that calls them.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import math
import threading
from collections.abc import Mapping
from typing import Any

import numpy as np

from holdfast.compiler.schedule import External
from holdfast.compiler.targets.llvm import cpu
from holdfast.compiler.targets.llvm.functions import constant, filled

_MINOR = 1  # the version of XLA's FFI is 0._MINOR: the oldest that XLA accepts; it has all that the handler needs
_UNKNOWN = "holdfast: this program's kernel is not in this process; expected holdfast.interop.to_jax of its chain first"
_EXHAUSTED = "holdfast: not enough memory for this kernel"
_ALIGNMENT = 64  # bytes; working memory begins at a cache line

_LOCK = threading.Lock()
_records: dict[int, np.ndarray] = {}  # by key; each is laid out as %record in `foreign_call.ll`
_kept: list[object] = []  # keeps the objects alive whose addresses have been published


def publish(
    name: str,
    single: cpu.Code,
    batch: cpu.Code,
    lanes: int,
    externals: Mapping[str, External],
    status: str,
    open_status: float,
) -> int:
    """Register a kernel so that XLA's programs can call it; return its key.

    Args:
        name: identifies the kernel in every process.
        single: its machine code with the functions `single` and `prepare`.
        batch: its machine code with the function `batch`.
        lanes: how many systems `batch` computes side by side.
        externals: the arrays that it reads and writes, results last.
        status: the name of the array that holds the status.
        open_status: the status of a system that is undecided; all its results become NaN.
    """
    digest = hashlib.sha256(f"{name}/{status}/{open_status!r}".encode()).digest()
    key = int.from_bytes(digest[:8], "little") >> 1  # an int64, positive
    with _LOCK:
        if key not in _records:
            addresses = [single.addresses["single"], single.addresses["prepare"], batch.address]
            memory = [8 * code.notes["arena"] + _ALIGNMENT for code in (single, batch)]
            arrays = [x for external in externals.values() for x in (len(external.shape), external.size)]
            known = [len(externals), list(externals).index(status), int(np.float64(open_status).view(np.int64))]
            _records[key] = np.array([*addresses, lanes, *memory, 0, 0, *known, *arrays], dtype=np.int64)
            table = np.array([len(_records), *(x for k, r in _records.items() for x in (k, r.ctypes.data))])
            _kept.extend((single, batch, table))
            ctypes.CFUNCTYPE(None, ctypes.c_void_p)(_code().addresses["publish"])(table.ctypes.data)
    return key


def capsule() -> Any:
    """Return a Python capsule of the function that XLA calls (`XLA_FFI_Handler` of its C interface)."""
    make = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p)
    return make(("PyCapsule_New", ctypes.pythonapi))(_code().address, None, None)


@functools.cache
def _code() -> cpu.Code:
    for name in ("PyMem_RawCalloc", "PyMem_RawFree"):
        cpu.declare(name, ctypes.cast(getattr(ctypes.pythonapi, name), ctypes.c_void_p).value or 0)
    texts = {"unknown": _UNKNOWN, "exhausted": _EXHAUSTED}
    sizes = {f"{name}_size": len(text) + 1 for name, text in texts.items()}
    text = filled("foreign_call", **texts, **sizes, minor=_MINOR, nan=constant(math.nan, 1))
    return cpu.Code(text, "handler", "publish")
