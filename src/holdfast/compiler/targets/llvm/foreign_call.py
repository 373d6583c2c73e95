"""Kernels as functions that XLA's programs call by address: those of JAX, on this processor.

One handler serves all kernels. A program says by an attribute `key` which it means, a number that is the same in every
process: programs that are kept on disk, where addresses would lie, find their kernel again or say that it is not here.
What is known here stays: no one tells when the last program is gone.
"""

from __future__ import annotations

import ctypes
import functools
import hashlib
import math
import threading
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from holdfast.compiler.schedule import External
from holdfast.compiler.targets.llvm import cpu
from holdfast.compiler.targets.llvm.functions import constant
from holdfast.compiler.targets.llvm.templates import filled

_MINOR = 1  # of XLA's FFI, 0.x: the oldest that XLA of today takes; what the handler needs is in all of them
_UNKNOWN = "holdfast: this program's kernel is not in this process; expected holdfast.interop.to_jax of its chain first"
_EXHAUSTED = "holdfast: not enough memory for this kernel"
_ALIGNMENT = 64  # bytes; working memory begins at a cache line

_LOCK = threading.Lock()
_records: dict[int, np.ndarray] = {}  # by key, laid out as %record in `foreign_call.ll`
_kept: list[object] = []  # what published addresses lie in


class Codes(NamedTuple):
    """A kernel's machine code.

    Attributes:
        single: functions `single` and `prepare`.
        batch: function `batch`.
        lanes: systems that it computes side by side.
    """

    single: cpu.Code
    batch: cpu.Code
    lanes: int


def publish(name: str, codes: Codes, externals: Mapping[str, External], status: str, open_status: float) -> int:
    """Let XLA's programs call a kernel; return its key.

    Args:
        name: stands for the kernel in every process.
        codes: its machine code.
        externals: the arrays it takes and returns, results last.
        status: which of them is the status.
        open_status: a status that is not decided: all results of such a system become not-a-number.
    """
    digest = hashlib.sha256(f"{name}/{status}/{open_status!r}".encode()).digest()
    key = int.from_bytes(digest[:8], "little") >> 1  # an int64, positive
    with _LOCK:
        if key not in _records:
            _records[key] = _record(codes, externals, status, open_status)
            table = np.array([len(_records), *(x for k, r in _records.items() for x in (k, r.ctypes.data))])
            _kept.extend((codes, table))
            ctypes.CFUNCTYPE(None, ctypes.c_void_p)(_code().addresses["publish"])(table.ctypes.data)
    return key


def capsule() -> Any:
    """Return the function that XLA calls, `XLA_FFI_Handler` of its C interface, as a capsule."""
    make = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_void_p)
    return make(("PyCapsule_New", ctypes.pythonapi))(_code().address, None, None)


def _record(codes: Codes, externals: Mapping[str, External], status: str, open_status: float) -> np.ndarray:
    addresses = codes.single.addresses
    memory = [8 * code.notes["arena"] + _ALIGNMENT for code in (codes.single, codes.batch)]
    head = [addresses["single"], addresses["prepare"], codes.batch.address, codes.lanes, *memory, 0, 0]
    arrays = [x for external in externals.values() for x in (len(external.shape), external.size)]
    known = [len(externals), list(externals).index(status), int(np.float64(open_status).view(np.int64))]
    return np.array([*head, *known, *arrays], dtype=np.int64)


@functools.cache
def _code() -> cpu.Code:
    for name in ("PyMem_RawCalloc", "PyMem_RawFree"):
        cpu.declare(name, ctypes.cast(getattr(ctypes.pythonapi, name), ctypes.c_void_p).value or 0)
    texts = {"unknown": _UNKNOWN, "exhausted": _EXHAUSTED}
    sizes = {f"{name}_size": len(text) + 1 for name, text in texts.items()}
    text = filled("foreign_call", **texts, **sizes, minor=_MINOR, nan=constant(math.nan, 1))
    return cpu.Code(text, "handler", "publish")
