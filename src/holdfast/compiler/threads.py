"""A batch divided among threads: as many as its caller asks for, or as many as make it faster on this machine.

`HOLDFAST_THREADS` bounds the number of threads of calls that do not ask for one.
"""

from __future__ import annotations

import functools
import os
import threading
from _thread import start_new_thread
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from holdfast.compiler.errors import CompileError

# Operations, each of them in all lanes, for which a thread is worth its start: they take some 0.4 ms, and starting a
# thread 0.05 ms.
LEAST_WORK = 2**21

_QUOTA = Path("/sys/fs/cgroup/cpu.max")  # the processor time of a container on Linux

Part = Callable[[int, int], None]  # runs the blocks from the first number up to, but without, the second

_lock = threading.Lock()
_busy = 0  # threads that work for calls that did not ask for a number


def divide(part: Part, blocks: int, work: int, threads: int | None) -> None:
    """Run all blocks of a batch, divided evenly among threads, the caller's own included.

    Args:
        part: runs some of the blocks.
        blocks: the number of blocks.
        work: the number of operations of a block.
        threads: the number of threads; None for as many as have `LEAST_WORK` each and a processor of their own. Calls
            that overlap share the processors.

    Raises:
        CompileError: `HOLDFAST_THREADS` is no positive integer.
    """
    if threads is not None:
        _run(part, blocks, max(1, min(threads, blocks)))
    elif (worth := min(blocks, blocks * work // LEAST_WORK)) < 2:
        part(0, blocks)
    else:
        with _processors(worth) as count:
            _run(part, blocks, count)


def usable_processors() -> int:
    """Return how many threads of this process can run at the same time, at most `HOLDFAST_THREADS`.

    Raises:
        CompileError: `HOLDFAST_THREADS` is no positive integer.
    """
    there = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    most = os.environ.get("HOLDFAST_THREADS") or str(there)
    if not most.isdecimal() or int(most) < 1:
        raise CompileError(f"HOLDFAST_THREADS: expected an integer >= 1, got {most!r}")
    return min(there, _quota(), int(most))


@functools.cache
def _quota() -> int:
    """Return how many processors' time the process may use, at least one."""
    try:
        time, period = _QUOTA.read_text().split()
        return max(1, int(time) // int(period))
    except (OSError, ValueError):  # there is no such file, or no quota: "max 100000"
        return os.cpu_count() or 1


@contextmanager
def _processors(wanted: int) -> Iterator[int]:
    """Yield how many threads may work within the context: at least one."""
    global _busy
    with _lock:
        count = max(1, min(wanted, usable_processors() - _busy))
        _busy += count
    try:
        yield count
    finally:
        with _lock:
            _busy -= count


def _run(part: Part, blocks: int, threads: int) -> None:
    """Run the blocks on some threads; the caller also runs the parts for which no thread can be started."""
    bounds = [blocks * t // threads for t in range(threads + 1)]
    finished: set[int] = set()
    errors: list[BaseException] = []

    def run(t: int, end: threading.Lock | None = None) -> None:
        try:
            part(bounds[t], bounds[t + 1])
        except BaseException as error:
            errors.append(error)
        finished.add(t)
        if end is not None:
            end.release()

    running: dict[int, threading.Lock] = {}
    with suppress(RuntimeError):  # the system starts no more threads
        for t in range(1, threads):
            end = threading.Lock()
            end.acquire()
            start_new_thread(run, (t, end))
            running[t] = end
    for t in range(threads):
        if t not in running:
            run(t)
    for t, end in running.items():
        while t not in finished:
            try:
                end.acquire()
            except BaseException as error:  # Ctrl-C: raised when no thread writes into the caller's arrays any more
                errors.append(error)
    if errors:
        raise errors[0]
