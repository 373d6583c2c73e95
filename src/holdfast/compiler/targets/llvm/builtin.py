"""Machine code as Python builtins: the shortest way from a Python call to a kernel.

NumPy's struct is not read, and of an object only its type: buffers come through `PyObject_GetBuffer` alone, in the
stable ABI since Python 3.11, for some 35 ns an array, 60 ns when its buffer is first asked for. Remembering the arrays
of the last call would spare that when they come again, but is not safe: `resize(refcheck=False)` moves and `dtype=`
reinterprets an array's memory under a held buffer, and a kernel that keeps its caller's arrays alive forbids them an
ordinary `resize`.
"""

from __future__ import annotations

import ctypes
import functools
import re
import sys
import sysconfig
import threading
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from holdfast.compiler.targets.llvm import cpu
from holdfast.compiler.targets.llvm.templates import filled

# With no global lock, two calls would write one table at a time.
_POSSIBLE = sys.implementation.name == "cpython" and not sysconfig.get_config_var("Py_GIL_DISABLED")
_MOST = 256  # inputs; a call keeps their views on the stack, 80 bytes each
_OUT = sys.intern("out")  # as Python does with keywords

_TYPE_OFFSET = object.__basicsize__ - 8  # where an object has its type: last in what all objects have

_EXPECTED, _BEGIN, _END = 4, 5, 6  # places in a record, which is an int64 array laid out as %record in `builtin.ll`

# What a template of a function is to Python: METH_FASTCALL | METH_KEYWORDS, or METH_NOARGS.
_FLAGS = {"call_with_arrays": 0x80 | 0x02, "call_without_arguments": 0x04}


class _MethodDef(ctypes.Structure):
    """Python's PyMethodDef."""

    _fields_ = (
        ("name", ctypes.c_char_p),
        ("function", ctypes.c_void_p),
        ("flags", ctypes.c_int),
        ("doc", ctypes.c_char_p),
    )


class Builtin:
    """A kernel's builtin; it owns what the builtin needs, and lives as long as that.

    Attributes:
        function: `function(x0, x1, ..., *, name=x, ..., out=result)`. With flat float64 inputs in C order and the
            expected `result`, it runs the kernel and returns `result`; any other call is the fallback's.
    """

    def __init__(
        self,
        run: int,
        table: np.ndarray,
        sizes: Sequence[int],
        fallback: Callable[..., Any],
        name: str = "kernel",
        signature: str = "(*inputs, out=None)",
        doc: str = "",
        names: Sequence[str] = (),
    ) -> None:
        """Make the builtin; until `expect` every call is the fallback's.

        Args:
            run: address of `i64 run(ptr table)`; it returns 0 when all is well, else the fallback is called too.
            table: int64; its first entries get the inputs' addresses, the others are the caller's.
            sizes: how many float64 each input holds.
            fallback: what takes the calls that machine code does not; it also keeps the code at `run` alive.
            name: what the builtin is called,
            signature: takes,
            doc: and does, for the reader.
            names: of the last inputs, which are given by name.
        """
        interned = tuple(map(sys.intern, names))
        words = np.array([id(word) for word in interned], dtype=np.int64)
        fixed = [run, table.ctypes.data, id(fallback), id(_OUT), 0, 0, 0, len(sizes), id(np.ndarray)]
        by_name = [len(sizes) - len(names), words.ctypes.data]
        self._record = np.array([*fixed, *by_name, *(8 * size for size in sizes)], dtype=np.int64)
        self._table, self._inputs = table, len(sizes)
        self._results: list[Any] = []
        self._lock = threading.Lock()
        self.function: Callable[..., Any] = fallback
        if _POSSIBLE and len(sizes) <= _MOST:
            self.function = _builtin(
                "call_with_arrays",
                name,
                signature,
                doc,
                self._record,
                table,
                fallback,
                _OUT,
                self._results,
                words,
                interned,
            )

    def expect(self, out: object, memory: np.ndarray, addresses: Sequence[int] = ()) -> None:
        """Let later calls with this very object as `out` run in machine code.

        Args:
            out: what they return; it is kept alive, and so is
            memory: the contiguous block where the kernel writes. Inputs inside it are the fallback's.
            addresses: what follows the inputs in the table from now on, changed when no call can use it.
        """
        with self._lock:
            self._record[_EXPECTED] = 0  # until all is changed, other threads' calls are the fallback's
            before = self._results.copy()  # let go of at the end, as that may run any code
            self._results[:] = out, memory
            begin = memory.ctypes.data
            self._record[_BEGIN], self._record[_END] = begin, begin + memory.nbytes
            self._table[self._inputs : self._inputs + len(addresses)] = addresses
            self._record[_EXPECTED] = id(out)
        del before


def no_argument_call(run: int, table: np.ndarray, keep: object, name: str = "call", doc: str = "") -> Callable[[], int]:
    """Return a builtin without arguments for control loops: it returns what `run(table)` returns.

    Args:
        run: address of `i64 run(ptr table)`.
        table: int64, filled by the caller.
        keep: what must live as long as the builtin, such as the code and the arrays in the table.
        name: what the builtin is called,
        doc: and does, for the reader.
    """
    if _POSSIBLE:
        record = np.array([run, table.ctypes.data], dtype=np.int64)
        return _builtin("call_without_arguments", name, "()", doc, record, table, keep)
    function, kept = ctypes.PYFUNCTYPE(ctypes.c_int64, ctypes.c_void_p)(run), (table, keep)
    return lambda: function(kept[0].ctypes.data)


def _builtin(
    template: str, name: str, signature: str, doc: str, record: np.ndarray, *keep: object
) -> Callable[..., Any]:
    """Return the builtin whose `self` is the record's address and all that the record points to.

    It is a tuple, as the garbage collector empties no tuple and no array when it breaks a cycle: whatever still calls
    the builtin then finds what the record points to.
    """
    new = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.py_object, ctypes.py_object)
    definition = _definition(template, name, f"{name}{signature}\n--\n\n{doc}")
    make = new(("PyCFunction_NewEx", ctypes.pythonapi))
    return make(ctypes.addressof(definition), (record.ctypes.data, record, *keep), __name__)


@functools.cache
def _definition(template: str, name: str, doc: str) -> _MethodDef:
    return _immortal(_MethodDef(name.encode(), _code(template).address, _FLAGS[template], doc.encode()))


@functools.cache
def _code(template: str) -> cpu.Code:
    head = filled("builtin")
    for name in re.findall(r"^declare .*@(\w+)", head, re.M):
        cpu.declare(name, ctypes.cast(getattr(ctypes.pythonapi, name), ctypes.c_void_p).value or 0)
    return _immortal(cpu.Code(head + filled(template, type_offset=_TYPE_OFFSET), "function"))


def _immortal(x: Any) -> Any:
    """Keep an object even after this module is gone: builtins read their PyMethodDef when they die."""
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(x))
    return x
