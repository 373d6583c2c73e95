"""Computation of chunks in this process, in other processes, which may die, or by any executor.

A `ProcessPoolExecutor` hung in tests that kill processes, presumably because a process was killed while it wrote to the
pipe that all of them share. Here each process has its own pipe, which closes with the process; and a process ends when
the reader of its pipe does.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import pickle
import signal
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.connection import wait as wait_for
from typing import Any

from holdfast.errors import ResultError
from holdfast.sweeps.chunk import Chunk, Computed, compute

MOST_DEATHS = 10  # deaths of processes without a computed chunk in between


def computed_here(tasks: Iterator[Chunk]) -> Iterator[Computed]:
    """Yield the results of chunks that are computed one after the other in this process."""
    return map(compute, tasks)


def computed_by_processes(tasks: Iterator[Chunk], count: int, most_deaths: int = MOST_DEATHS) -> Iterator[Computed]:
    """Yield the results of chunks that processes of this computer compute; those that die are replaced.

    Raises:
        ResultError: processes die repeatedly.
    """
    again: list[Chunk] = []
    at_work: dict[Any, Chunk] = {}
    processes: dict[Any, Any] = dict(_new_process() for _ in range(count))
    deaths = 0
    try:
        while True:
            for pipe in processes.keys() - at_work.keys():
                task = again.pop() if again else next(tasks, None)
                if task is None:
                    break
                at_work[pipe] = task
                with contextlib.suppress(OSError):  # the process has died, which reading will show
                    pipe.send(task)
            if not at_work:
                return
            for pipe in wait_for(list(at_work)):
                task = at_work.pop(pipe)
                found = _received(pipe)
                if isinstance(found, Exception):
                    raise found
                if found is not None:
                    deaths = 0
                    yield found
                    continue
                again.append(task)
                deaths += 1
                if deaths > most_deaths:
                    raise ResultError(
                        f"sweep: its processes died {deaths} times without finishing a chunk; try a smaller `chunk` if"
                        " memory ran out, and `if __name__ == '__main__':` around the call in a script"
                    )
                _end(pipe, processes.pop(pipe))
                processes |= [_new_process()]
    finally:
        for pipe, process in processes.items():
            _end(pipe, process)


def computed_by(executor: Executor, tasks: Iterator[Chunk], ahead: int) -> Iterator[Computed]:
    """Yield the results of chunks that an executor of the user computes; a limited number is submitted at a time.

    Raises:
        ResultError: the executor is broken.
    """
    waiting: set[Future[Computed]] = set()
    try:
        while True:
            while len(waiting) < ahead and (task := next(tasks, None)) is not None:
                waiting.add(executor.submit(compute, task))
            if not waiting:
                return
            for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                waiting.remove(future)
                yield future.result()
    except BrokenExecutor as cause:
        raise ResultError(
            f"sweep: the executor broke ({cause}); what is finished is kept; try the same call with another executor"
        ) from cause
    finally:
        for future in waiting:
            future.cancel()


@contextlib.contextmanager
def deaf_to_interrupts() -> Iterator[None]:
    """Block Ctrl-C in processes that start within the context, since terminals send it to all; delay it in this one."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # a starting process unblocks blocked signals
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # threads and processes inherit this
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _new_process() -> tuple[Connection, Any]:
    """Start a process, and return the pipe to it and the process."""
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=_serve, args=(there,), daemon=True)
    with deaf_to_interrupts():
        process.start()
    there.close()  # so that the pipe closes with the process
    return here, process


def _end(pipe: Any, process: Any) -> None:
    pipe.close()
    process.terminate()
    process.join()


def _received(pipe: Any) -> Computed | Exception | None:
    """Return the object that a process sent; None if it died."""
    try:
        return pipe.recv()
    except (EOFError, OSError):
        return None


def _serve(pipe: Connection) -> None:
    """Compute chunks until the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the reading process ends this one
    with contextlib.suppress(EOFError, OSError):
        while True:
            task = pipe.recv()
            try:
                found = compute(task)
            except Exception as error:
                found = _travelling(error)
            pipe.send(found)


def _travelling(error: Exception) -> Exception:
    """Return an error, or its text if it cannot be pickled."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return ResultError(f"sweep: a chunk failed: {type(error).__name__}: {error}")
    return error
