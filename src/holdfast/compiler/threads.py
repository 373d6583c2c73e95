"""A batch divided among threads: as many as its caller asks for, or as many as make it faster on this machine.

`HOLDFAST_THREADS` bounds the number of threads of calls that do not ask for one.
"""

from __future__ import annotations

import functools
import os
import threading
from _thread import start_new_thread
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import pairwise
from pathlib import Path

from holdfast.compiler.errors import CompileError

# Operations, each of them in all lanes, for which a thread is worth its start: they take some 0.4 ms, and starting a
# thread 0.05 ms.
LEAST_WORK = 2**21
_SHARES = 4  # of a thread: where some threads are slower than others, the others take more of them

# Files of Linux: the processor time of a container, and how many threads run.
_QUOTA, _LOAD = Path("/sys/fs/cgroup/cpu.max"), Path("/proc/loadavg")

Part = Callable[[int, int], None]  # runs the blocks from the first number up to, but without, the second

_lock = threading.Lock()
_busy = 0  # threads that work for calls that did not ask for a number


def divide(part: Part, blocks: int, work: int, threads: int | None) -> None:
    """Run all blocks of a batch, divided among threads, the caller's own included.

    Args:
        part: runs some of the blocks.
        blocks: the number of blocks.
        work: the number of operations of a block.
        threads: the number of threads; None for as many as have `LEAST_WORK` each and a free processor. Calls that
            overlap share the processors.

    Raises:
        CompileError: `HOLDFAST_THREADS` is no positive integer.
    """
    wanted = min(blocks, blocks * work // LEAST_WORK if threads is None else threads)
    if wanted < 2:
        part(0, blocks)
    elif threads is not None:
        _run(part, blocks, wanted)
    else:
        with _processors(wanted) as count:
            _run(part, blocks, count)


def free_processors() -> int:
    """Return how many threads of this process can run at the same time, its own one included.

    They are bounded by `HOLDFAST_THREADS`, by what the system lets the process use, and on Linux by the processors that
    no other thread or process uses at the moment.

    Raises:
        CompileError: `HOLDFAST_THREADS` is no positive integer.
    """
    there = os.cpu_count() or 1
    most = os.environ.get("HOLDFAST_THREADS") or str(there)
    if not most.isdecimal() or int(most) < 1:
        raise CompileError(f"HOLDFAST_THREADS: expected an integer >= 1, got {most!r}")
    allowed = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else there
    return max(1, min(int(most), allowed, _quota(), there + 1 - _running()))


@functools.cache
def _quota() -> int:
    """Return how many processors' time the process may use."""
    try:
        time, period = _QUOTA.read_text().split()
        return int(time) // int(period)
    except (OSError, ValueError):  # there is no such file, or no quota: "max 100000"
        return os.cpu_count() or 1


def _running() -> int:
    """Return how many threads of all processes have something to do, this one included; 1 if that is unknown."""
    try:
        return int(_LOAD.read_text().split()[3].partition("/")[0])
    except (OSError, ValueError, IndexError):
        return 1


@contextmanager
def _processors(wanted: int) -> Iterator[int]:
    """Yield how many threads may work within the context: at least one."""
    global _busy
    with _lock:
        count = max(1, min(wanted, free_processors() - _busy))
        _busy += count
    try:
        yield count
    finally:
        with _lock:
            _busy -= count


def _run(part: Part, blocks: int, threads: int) -> None:
    """Run the blocks on some threads, each of which takes one share after another, and wait for them.

    The caller runs all shares for which no other thread gets a processor in time.
    """
    count = min(blocks, threads * _SHARES)
    shares = deque([*pairwise(blocks * k // count for k in range(count + 1)), *[None] * threads])
    errors: list[BaseException] = []
    running: list[threading.Lock] = []

    def work(busy: threading.Lock) -> None:
        with busy:
            try:
                for begin, end in iter(shares.popleft, None):
                    if errors:
                        return
                    part(begin, end)
            except BaseException as error:
                errors.append(error)

    with suppress(RuntimeError):  # the system starts no more threads
        for _ in range(1, threads):
            running.append(threading.Lock())
            start_new_thread(work, (running[-1],))
    work(threading.Lock())
    while running:
        try:
            with running[-1]:
                running.pop()
        except BaseException as error:  # Ctrl-C: raised when no thread writes into the caller's arrays any more
            errors.append(error)
    if errors:
        raise errors[0]
