"""Kernels by structure: each is made once per process, and its machine code once per machine."""

from __future__ import annotations

import functools
import hashlib
import threading
import weakref
from collections import OrderedDict
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path

import holdfast.compiler
from holdfast.compiled.computation import Computation
from holdfast.compiler.kernel import BatchKernel, Kernel
from holdfast.compiler.schedule import Schedule
from holdfast.compiler.targets import cpu
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.forest import Forest
from holdfast.progress import busy, detail

# The packages whose functions become machine code.
_ROOMS = ("spatial", "model", "state", "questions", "dynamics", "forces", "compiler", "compiled")

_made: weakref.WeakValueDictionary[str, Kernel] = weakref.WeakValueDictionary()
_recent: OrderedDict[str, BatchKernel] = OrderedDict()  # those of steps, which a next run may need again
MOST_RECENT = 32
_lock = threading.Lock()


def key_of(made: Computation) -> str:
    """Return the cache key of a computation for chains of one structure; "" if it has no name."""
    return made.name and f"{made.name}/{made.structure.key}/{_sources(*made.packages)}"


def kernel(made: Computation) -> Kernel:
    """Return the kernel of one computation; its schedule is made only if the machine code is not in the cache."""
    if not (key := key_of(made)):
        return Kernel(made.externals, _told(made))
    key = f"{key}/{cpu.target().name}"
    with _lock:
        found = _made.get(key)
        if found is None:
            found = _made[key] = Kernel(made.externals, _told(made), key)
        return found


def batch_kernel(made: Computation, quick: bool = False, what: str = "steps") -> BatchKernel:
    """Return a kernel of one computation for batches only.

    Args:
        made: the computation.
        quick: whether to shorten compilation at the cost of run time.
        what: what it is called where compiling it is shown.
    """
    shown = partial(compiling, made.structure.chain, what, None)
    if not (key := key_of(made)):
        return BatchKernel(made.externals, _told(made), quick=quick, shown=shown)
    place = f"{key}/{cpu.target().name}/{quick}"
    with _lock:
        found = _recent.pop(place, None) or BatchKernel(made.externals, _told(made), key, quick=quick, shown=shown)
        _recent[place] = found
        if len(_recent) > MOST_RECENT:
            _recent.popitem(last=False)
    return found


def compiling(chain: ClosedChain | Forest, what: str, progress: bool | None) -> AbstractContextManager[None]:
    """Show that a computation of a chain or forest is compiled within this context; see `busy`."""
    whose = "a forest" if isinstance(chain, Forest) else ", ".join(chain.names)
    return busy(progress, f"compiling {what} of {whose}")


def compile_batch(code: Kernel, chain: ClosedChain, what: str, progress: bool | None) -> None:
    """Compile what a batch of a computation needs, if it is not compiled yet, and show it; see `busy`."""
    if not code.batch_is_compiled:
        with compiling(chain, f"{what} for batches", progress):
            detail(operations(code.operation_count))
            code.compile_batch()


def _told(made: Computation) -> Callable[[], Schedule]:
    """Return the function that makes the schedule of a computation, and shows how long it is."""

    def schedule() -> Schedule:
        found = made.schedule()
        detail(operations(found.operation_count))
        return found

    return schedule


def operations(count: int) -> str:
    """Return a number of operations in words."""
    return f"{count:,} operations"


@functools.cache
def _sources(*further: str) -> str:
    """Return a digest of the sources on which machine code depends, templates of LLVM's language included."""
    root = Path(holdfast.compiler.__file__).parent.parent
    digest = hashlib.sha256()
    for room in (*_ROOMS, *further):
        files = [path for suffix in ("*.py", "*.ll") for path in (root / room).rglob(suffix)]
        for path in sorted(files) or [root / f"{room}.py"]:
            digest.update(path.name.encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()
