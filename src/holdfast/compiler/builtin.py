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
import sys
import sysconfig
import threading
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from holdfast.compiler import cpu

# With no global lock, two calls would write one table at a time.
_POSSIBLE = sys.implementation.name == "cpython" and not sysconfig.get_config_var("Py_GIL_DISABLED")
_MOST = 256  # inputs; a call keeps their views on the stack, 80 bytes each
_OUT = sys.intern("out")  # as Python does with keywords

_TYPE = object.__basicsize__ - 8  # where an object has its type: last in what all objects have

_EXPECTED, _BEGIN, _END = 4, 5, 6  # places in a plan, which is an int64 array laid out as %plan below

_HEAD = """
%plan = type { ptr, ptr, ptr, ptr, ptr, i64, i64, i64, ptr, [0 x i64] }
; run, table, fallback, "out", expected, begin and end of its memory, number of inputs, the type of arrays, their bytes
%buffer = type { ptr, ptr, i64, i64, i32, i32, ptr, ptr, ptr, ptr, ptr }
; buf, obj, len, itemsize, readonly, ndim, format, shape, strides, suboffsets, internal

declare ptr @PyTuple_GetItem(ptr, i64)
declare i64 @PyTuple_Size(ptr)
declare ptr @PyLong_AsVoidPtr(ptr)
declare ptr @PyLong_FromLongLong(i64)
declare i32 @PyObject_GetBuffer(ptr, ptr, i32)
declare void @PyBuffer_Release(ptr)
declare void @PyErr_Clear()
declare i32 @PyType_IsSubtype(ptr, ptr)
declare void @Py_IncRef(ptr)
declare ptr @PyObject_Vectorcall(ptr, ptr, i64, ptr)
"""

_NO_ARGUMENT = """
define ptr @function(ptr %self, ptr %none) {
  %address = call ptr @PyTuple_GetItem(ptr %self, i64 0)
  %plan = call ptr @PyLong_AsVoidPtr(ptr %address)
  %run = load ptr, ptr %plan
  %table.at = getelementptr %plan, ptr %plan, i64 0, i32 1
  %table = load ptr, ptr %table.at
  %status = call i64 %run(ptr %table)
  %result = call ptr @PyLong_FromLongLong(i64 %status)
  ret ptr %result
}
"""

# Taking and releasing a buffer may run Python code, and that may call the same builtin. Hence the table is written
# only when all buffers are there, and nothing that runs Python comes between that and the kernel.
_ENTRY = f"""
define ptr @function(ptr %self, ptr %args, i64 %given, ptr %names) {{
  %address = call ptr @PyTuple_GetItem(ptr %self, i64 0)
  %plan = call ptr @PyLong_AsVoidPtr(ptr %address)
  %count.at = getelementptr %plan, ptr %plan, i64 0, i32 7
  %count = load i64, ptr %count.at
  %out.at = getelementptr ptr, ptr %args, i64 %count
  %right.count = icmp eq i64 %given, %count
  %named = icmp ne ptr %names, null
  %likely = and i1 %right.count, %named
  br i1 %likely, label %keyword, label %slow

keyword:
  %keywords = call i64 @PyTuple_Size(ptr %names)
  %name = call ptr @PyTuple_GetItem(ptr %names, i64 0)
  %word.at = getelementptr %plan, ptr %plan, i64 0, i32 3
  %word = load ptr, ptr %word.at
  %array.at = getelementptr %plan, ptr %plan, i64 0, i32 8
  %array = load ptr, ptr %array.at
  %one = icmp eq i64 %keywords, 1
  %right.word = icmp eq ptr %name, %word
  %only.out = and i1 %one, %right.word
  br i1 %only.out, label %take, label %slow

take:
  %views = alloca %buffer, i64 %count, align 8
  br label %more

more:
  %i = phi i64 [ 0, %take ], [ %i.next, %second ]
  %i.next = add i64 %i, 1
  %taken.all = icmp eq i64 %i, %count
  br i1 %taken.all, label %ready, label %next

next:
  %x.at = getelementptr ptr, ptr %args, i64 %i
  %x = load ptr, ptr %x.at
  %type.at = getelementptr i8, ptr %x, i64 {_TYPE}
  %type = load ptr, ptr %type.at
  %plain = icmp eq ptr %type, %array
  br i1 %plain, label %acquire, label %other

other:  ; what derives from arrays may mean more than its buffer, such as one with a mask
  %derived = call i32 @PyType_IsSubtype(ptr %type, ptr %array)
  %more.than.numbers = icmp ne i32 %derived, 0
  br i1 %more.than.numbers, label %release, label %acquire

acquire:
  %view = getelementptr %buffer, ptr %views, i64 %i
  %failed = call i32 @PyObject_GetBuffer(ptr %x, ptr %view, i32 12)  ; format, C order
  %taken = icmp eq i32 %failed, 0
  br i1 %taken, label %check, label %refused

refused:
  call void @PyErr_Clear()
  br label %release

check:
  %start = load ptr, ptr %view
  %start.number = ptrtoint ptr %start to i64
  %misaligned = and i64 %start.number, 7
  %bytes.at = getelementptr %buffer, ptr %view, i64 0, i32 2
  %bytes = load i64, ptr %bytes.at
  %size.at = getelementptr %plan, ptr %plan, i64 0, i32 9, i64 %i
  %size = load i64, ptr %size.at
  %ndim.at = getelementptr %buffer, ptr %view, i64 0, i32 5
  %ndim = load i32, ptr %ndim.at
  %format.at = getelementptr %buffer, ptr %view, i64 0, i32 6
  %format = load ptr, ptr %format.at
  %aligned = icmp eq i64 %misaligned, 0
  %right.size = icmp eq i64 %bytes, %size
  %flat = icmp eq i32 %ndim, 1
  %described = icmp ne ptr %format, null
  %and.1 = and i1 %aligned, %right.size
  %and.2 = and i1 %flat, %described
  %and.3 = and i1 %and.1, %and.2
  br i1 %and.3, label %first, label %release

first:
  %letter = load i8, ptr %format
  %double = icmp eq i8 %letter, 100  ; d
  br i1 %double, label %second, label %release

second:
  %after.at = getelementptr i8, ptr %format, i64 1
  %after = load i8, ptr %after.at
  %whole = icmp eq i8 %after, 0
  br i1 %whole, label %more, label %release

ready:
  %out = load ptr, ptr %out.at
  %expected.at = getelementptr %plan, ptr %plan, i64 0, i32 4
  %expected = load ptr, ptr %expected.at
  %begin.at = getelementptr %plan, ptr %plan, i64 0, i32 5
  %begin = load i64, ptr %begin.at
  %end.at = getelementptr %plan, ptr %plan, i64 0, i32 6
  %end = load i64, ptr %end.at
  %run = load ptr, ptr %plan
  %table.at = getelementptr %plan, ptr %plan, i64 0, i32 1
  %table = load ptr, ptr %table.at
  %same = icmp eq ptr %out, %expected
  br i1 %same, label %place, label %release

place:
  %j = phi i64 [ 0, %ready ], [ %j.next, %write ]
  %j.next = add i64 %j, 1
  %placed.all = icmp eq i64 %j, %count
  br i1 %placed.all, label %compute, label %apart

apart:
  %input = getelementptr %buffer, ptr %views, i64 %j
  %from = load i64, ptr %input
  %length.at = getelementptr %buffer, ptr %input, i64 0, i32 2
  %length = load i64, ptr %length.at
  %to = add i64 %from, %length
  %before = icmp ule i64 %to, %begin
  %behind = icmp uge i64 %from, %end
  %clear = or i1 %before, %behind
  br i1 %clear, label %write, label %release

write:
  %entry = getelementptr i64, ptr %table, i64 %j
  store i64 %from, ptr %entry
  br label %place

compute:
  %status = call i64 %run(ptr %table)
  %well = icmp eq i64 %status, 0
  br label %release

release:
  %done = phi i1 [ false, %other ], [ false, %refused ], [ false, %check ], [ false, %first ], [ false, %second ],
                 [ false, %ready ], [ false, %apart ], [ %well, %compute ]
  %held = phi i64 [ %i, %other ], [ %i, %refused ], [ %i.next, %check ], [ %i.next, %first ], [ %i.next, %second ],
                  [ %count, %ready ], [ %count, %apart ], [ %count, %compute ]
  br label %drop

drop:
  %left = phi i64 [ %held, %release ], [ %last, %let.go ]
  %none = icmp eq i64 %left, 0
  br i1 %none, label %finish, label %let.go

let.go:
  %last = sub i64 %left, 1
  %old = getelementptr %buffer, ptr %views, i64 %last
  call void @PyBuffer_Release(ptr %old)
  br label %drop

finish:
  br i1 %done, label %return, label %slow

return:
  %result = load ptr, ptr %out.at
  call void @Py_IncRef(ptr %result)
  ret ptr %result

slow:
  %fallback.at = getelementptr %plan, ptr %plan, i64 0, i32 2
  %fallback = load ptr, ptr %fallback.at
  %found = call ptr @PyObject_Vectorcall(ptr %fallback, ptr %args, i64 %given, ptr %names)
  ret ptr %found
}}
"""

_FLAGS = {_ENTRY: 0x80 | 0x02, _NO_ARGUMENT: 0x04}  # METH_FASTCALL | METH_KEYWORDS, METH_NOARGS


class _MethodDef(ctypes.Structure):
    """Python's PyMethodDef."""

    _fields_ = (
        ("name", ctypes.c_char_p),
        ("function", ctypes.c_void_p),
        ("flags", ctypes.c_int),
        ("doc", ctypes.c_char_p),
    )


class Entry:
    """A kernel's builtin; it owns what the builtin needs, and lives as long as that.

    Attributes:
        function: `function(x0, x1, ..., *, out=result)`. With flat float64 inputs in C order and the expected
            `result`, it runs the kernel and returns `result`; any other call is the fallback's.
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
        """
        fixed = [run, table.ctypes.data, id(fallback), id(_OUT), 0, 0, 0, len(sizes), id(np.ndarray)]
        self._plan = np.array([*fixed, *(8 * size for size in sizes)], dtype=np.int64)
        self._table, self._inputs = table, len(sizes)
        self._results: list[Any] = []
        self._lock = threading.Lock()
        self.function: Callable[..., Any] = fallback
        if _POSSIBLE and len(sizes) <= _MOST:
            self.function = _builtin(_ENTRY, name, signature, doc, self._plan, table, fallback, _OUT, self._results)

    def expect(self, out: object, memory: np.ndarray, addresses: Sequence[int] = ()) -> None:
        """Let later calls with this very object as `out` run in machine code.

        Args:
            out: what they return; it is kept alive, and so is
            memory: the contiguous block where the kernel writes. Inputs inside it are the fallback's.
            addresses: what follows the inputs in the table from now on, changed when no call can use it.
        """
        with self._lock:
            self._plan[_EXPECTED] = 0  # until all is changed, other threads' calls are the fallback's
            before = self._results.copy()  # let go of at the end, as that may run any code
            self._results[:] = out, memory
            begin = memory.ctypes.data
            self._plan[_BEGIN], self._plan[_END] = begin, begin + memory.nbytes
            self._table[self._inputs : self._inputs + len(addresses)] = addresses
            self._plan[_EXPECTED] = id(out)
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
        plan = np.array([run, table.ctypes.data], dtype=np.int64)
        return _builtin(_NO_ARGUMENT, name, "()", doc, plan, table, keep)
    function, kept = ctypes.PYFUNCTYPE(ctypes.c_int64, ctypes.c_void_p)(run), (table, keep)
    return lambda: function(kept[0].ctypes.data)


def _builtin(text: str, name: str, signature: str, doc: str, plan: np.ndarray, *keep: object) -> Callable[..., Any]:
    """Return the builtin whose `self` is the plan's address and all that the plan points to.

    It is a tuple, as the garbage collector empties no tuple and no array when it breaks a cycle: whatever still calls
    the builtin then finds what the plan points to.
    """
    new = ctypes.PYFUNCTYPE(ctypes.py_object, ctypes.c_void_p, ctypes.py_object, ctypes.py_object)
    definition = _definition(text, name, f"{name}{signature}\n--\n\n{doc}")
    make = new(("PyCFunction_NewEx", ctypes.pythonapi))
    return make(ctypes.addressof(definition), (plan.ctypes.data, plan, *keep), __name__)


@functools.cache
def _definition(text: str, name: str, doc: str) -> _MethodDef:
    return _immortal(_MethodDef(name.encode(), _code(text).address, _FLAGS[text], doc.encode()))


@functools.cache
def _code(text: str) -> cpu.Code:
    for line in _HEAD.splitlines():
        if line.startswith("declare"):
            name = line[line.index("@") + 1 : line.index("(")]
            cpu.declare(name, ctypes.cast(getattr(ctypes.pythonapi, name), ctypes.c_void_p).value or 0)
    return _immortal(cpu.Code(_HEAD + text, "function"))


def _immortal(x: Any) -> Any:
    """Keep an object even after this module is gone: builtins read their PyMethodDef when they die."""
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(x))
    return x
