"""Machine code as Python builtins: the fastest way from a Python call to a kernel.

The machine code reads only the type of a Python object, and gets an array's memory by `PyObject_GetBuffer`, which
belongs to the stable ABI since Python 3.11. This takes some 35 ns per array, and 60 ns for the first buffer of an
array. Remembering the arrays of the last call would save this time for repeated calls, but it would not be safe:
`resize(refcheck=False)` moves an array's memory and `dtype=` reinterprets it while a buffer is held, and a kernel
that kept its caller's arrays alive would make an ordinary `resize` fail.
"""

from __future__ import annotations

import ctypes
import functools
import math
import re
import sys
import sysconfig
import threading
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from holdfast.compiler.targets.llvm import cpu
from holdfast.compiler.targets.llvm.functions import filled

# Without the global interpreter lock, two threads could write the same table at the same time.
_POSSIBLE = sys.implementation.name == "cpython" and not sysconfig.get_config_var("Py_GIL_DISABLED")
_MOST = 256  # the largest number of inputs; a call keeps a buffer of 80 bytes for each on the stack
_OUT = sys.intern("out")  # Python interns the names of keywords, so they can be compared by address

_TYPE_OFFSET = object.__basicsize__ - 8  # the type is the last field of the header that all objects share

# Places in a record, which is an int64 array laid out as %record in `builtin.ll`.
_EXPECTED, _BEGIN, _END, _COPY, _SHOWN, _OWN = 4, 5, 6, 12, 13, 14

# Python's flags for the function of each template: METH_FASTCALL | METH_KEYWORDS, or METH_NOARGS.
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
    """A Python builtin that runs a kernel, and the memory that the builtin uses.

    Attributes:
        function: `function(x0, x1, ..., *, name=x, ..., out=result)`. With float64 inputs of the right shapes in C
            order and the expected `result`, it runs the kernel and returns `result`; without `out`, it returns what
            `answer` was told. It passes any other call to the fallback.
    """

    def __init__(
        self,
        run: int,
        table: np.ndarray,
        shapes: Sequence[tuple[int, ...]],
        fallback: Callable[..., Any],
        name: str = "kernel",
        signature: str = "(*inputs, out=None)",
        doc: str = "",
        names: Sequence[str] = (),
        by_name: int | None = None,
        largest: Sequence[float] = (),
        poses: Sequence[bool] = (),
        finite: int = 0,
    ) -> None:
        """Make the builtin; until `expect` or `answer` is called, it passes every call to the fallback.

        Args:
            run: the address of `i64 run(ptr table)`, which returns 0 for success; otherwise the fallback runs too.
            table: an int64 array. The builtin writes the inputs' addresses to its first entries; the caller fills
                the others.
            shapes: the shape of each input; if one has neither one nor two axes, `function` is the fallback.
            fallback: the Python function for all other calls; it must also keep the code at `run` alive.
            name: the builtin's `__name__`.
            signature: the builtin's signature, as `help` shows it.
            doc: the builtin's docstring.
            names: the names of the last inputs, by which they can be passed.
            by_name: how many of the last inputs are passed by name only; by default all that have names.
            largest: the largest size of each input's numbers in calls that the builtin answers; by default they are
                not looked at.
            poses: whether each input is a pose, whose quaternion must be of unit length.
            finite: 1 if all results must be finite, 2 if they may be +infinity, 0 if they are not looked at.
        """
        interned, count = tuple(map(sys.intern, names)), len(shapes)
        words = np.array([0] * (count - len(names)) + [id(word) for word in interned], dtype=np.int64)
        placed = count - (len(names) if by_name is None else by_name)
        fixed = [run, table.ctypes.data, id(fallback), id(_OUT), 0, 0, 0, count, id(np.ndarray)]
        sizes = [8 * math.prod(shape) for shape in shapes]
        bounds = np.array(largest or [-1.0] * count).view(np.int64).tolist()
        of_inputs = zip(
            sizes, map(len, shapes), [s[0] if s else 0 for s in shapes], bounds, poses or [0] * count, strict=True
        )
        further = [finite, 0, 0, 0, 0, 0]
        numbers = [*fixed, placed, words.ctypes.data, *further, *(int(x) for one in of_inputs for x in one)]
        self._record = np.array(numbers, dtype=np.int64)
        self._table, self._inputs = table, count
        self._results, self._answers = list[Any](), list[Any]()
        self._lock = threading.Lock()
        self.function: Callable[..., Any] = fallback
        if _POSSIBLE and count <= _MOST and all(len(shape) in (1, 2) for shape in shapes):
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
                self._answers,
                words,
                interned,
            )

    def expect(self, out: object, memory: np.ndarray, addresses: Sequence[int] = ()) -> None:
        """Let later calls with this very object as `out` run in machine code.

        Args:
            out: the object that these calls return; it is kept alive.
            memory: the contiguous block to which the kernel writes; it is kept alive. Calls with an input inside
                this block go to the fallback.
            addresses: the new entries of the table after the inputs' addresses. They are written while all calls go
                to the fallback.
        """
        with self._lock:
            self._record[_EXPECTED] = 0  # until the record is complete, calls of other threads go to the fallback
            before = self._results.copy()  # released at the very end, because a destructor may run any code
            self._results[:] = out, memory
            begin = memory.ctypes.data
            self._record[_BEGIN], self._record[_END] = begin, begin + memory.nbytes
            self._table[self._inputs : self._inputs + len(addresses)] = addresses
            self._record[_EXPECTED] = id(out)
        del before

    def answer(
        self, table: np.ndarray, memory: np.ndarray, copy: Callable[[], Any], shown: Callable[[Any], Any] | None = None
    ) -> None:
        """Let later calls without `out` run in machine code.

        Args:
            table: as that of the constructor, with the addresses of results in `memory`.
            memory: the contiguous block to which these calls write. Nobody else may read it.
            copy: returns a copy of the results; a builtin, so that no other thread runs before it has copied.
            shown: makes what these calls return of the copy; by default it is returned as it is.
        """
        self._answers[:] = table, memory, copy, shown
        begin = memory.ctypes.data
        self._record[_OWN : _OWN + 3] = begin, begin + memory.nbytes, table.ctypes.data
        self._record[_SHOWN] = 0 if shown is None else id(shown)
        self._record[_COPY] = id(copy)


def no_argument_call(run: int, table: np.ndarray, keep: object, name: str = "call", doc: str = "") -> Callable[[], int]:
    """Return a builtin without arguments for control loops: it returns the result of `run(table)`.

    Args:
        run: the address of `i64 run(ptr table)`.
        table: an int64 array, filled by the caller.
        keep: an object that must live as long as the builtin, such as the owner of the code and the arrays.
        name: the builtin's `__name__`.
        doc: the builtin's docstring.
    """
    if _POSSIBLE:
        record = np.array([run, table.ctypes.data], dtype=np.int64)
        return _builtin("call_without_arguments", name, "()", doc, record, table, keep)
    function, kept = ctypes.PYFUNCTYPE(ctypes.c_int64, ctypes.c_void_p)(run), (table, keep)
    return lambda: function(kept[0].ctypes.data)


def _builtin(
    template: str, name: str, signature: str, doc: str, record: np.ndarray, *keep: object
) -> Callable[..., Any]:
    """Return a builtin whose `self` is a tuple: the address of the record and the objects to which the record points.

    The garbage collector never empties tuples or arrays when it breaks a cycle, so a call during collection is safe.
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
    """Keep an object alive for ever, because builtins read their PyMethodDef when they are destroyed at exit."""
    ctypes.pythonapi.Py_IncRef(ctypes.py_object(x))
    return x
