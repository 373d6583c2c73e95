"""Computation of chunks in this process, in other processes, by any executor or by a Dask cluster; all may die.

A `ProcessPoolExecutor` hung in tests that kill processes, presumably because a process was killed while it wrote to the
pipe that all of them share. Here each process has its own pipe, which closes with the process; and a process ends when
the reader of its pipe does.

Dask itself repeats the chunks of dead workers. The chunks of a dead scheduler are given to its successor at the same
address; a local cluster is started again.
"""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import pickle
import signal
import tempfile
import warnings
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.connection import wait as wait_for
from typing import Any

from holdfast.errors import HoldfastError, MissingExtra, ResultError, StateError
from holdfast.io.files import one_line
from holdfast.model import checks
from holdfast.simulation.rollout.arguments import whole_number
from holdfast.sweeps.chunk import Chunk, Computed, compute

MOST_WORKERS = 4096
MOST_DEATHS = 10  # deaths of processes without a computed chunk in between
LOCAL = "local"  # a cluster of this computer's processes
# settings of a local cluster: background work of Dask, which would take several per cent of a processor
LOCAL_SETTINGS = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "5s",
}
MOST_LOSSES = 10  # losses of chunks or of the scheduler without a computed chunk in between
CONNECTION_TIMEOUT = 30.0  # time to wait for a scheduler and its first worker [s]


def require_workers(workers: Any, cluster: Any) -> None:
    """Refuse invalid workers, and an executor together with a cluster.

    Raises:
        StateError: there are such arguments; the message names them.
        MissingExtra: a cluster is given, but distributed is not installed.
    """
    by_executor = isinstance(workers, Executor) or hasattr(workers, "submit")
    if not by_executor:
        whole_number("workers", workers, MOST_WORKERS)
    if cluster is None:
        return
    if not isinstance(cluster, str) or not cluster:
        raise StateError(
            f"cluster: expected an address such as 'tcp://10.0.0.1:8786', or 'local', got {checks.short(cluster)}"
        )
    if by_executor or (cluster != LOCAL and workers != 1):
        raise StateError(
            f"workers: expected none beside cluster={checks.short(cluster)}, which has its own, got"
            f" {checks.short(workers)}; try one of both, or cluster='local'"
        )
    require_dask()


def computed_chunks(
    tasks: Iterator[Chunk], workers: Any, cluster: str | None, ahead: int, count: int
) -> Iterator[Computed]:
    """Yield the results of `count` chunks; `workers`, `cluster` and `ahead` are arguments of `sweep`."""
    if cluster is not None:
        return computed_by_cluster(cluster, workers, tasks, ahead) if count else iter(())
    if not isinstance(workers, int):
        return computed_by(workers, tasks, ahead)
    if workers == 1 or count == 0:
        return computed_here(tasks)
    return computed_by_processes(tasks, workers)


def computed_here(tasks: Iterator[Chunk]) -> Iterator[Computed]:
    """Yield the results of chunks that are computed one after the other in this process."""
    return (compute(task, threads=None) for task in tasks)


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


def require_dask() -> Any:
    """Return `dask.distributed`.

    Raises:
        MissingExtra: it is not installed.
    """
    try:
        import distributed
    except ImportError as cause:
        raise MissingExtra("a cluster needs Dask; try pip install 'holdfast[dask]'") from cause
    return distributed


def computed_by_cluster(cluster: str, workers: int, tasks: Iterator[Chunk], ahead: int) -> Iterator[Computed]:
    """Yield the results of chunks that a cluster computes.

    Args:
        cluster: address of the scheduler, or `LOCAL`.
        workers: number of processes of a local cluster.
        tasks: the chunks.
        ahead: largest number of chunks that are submitted at a time.

    Raises:
        ResultError: no scheduler or no worker responds, or chunks are lost repeatedly.
    """
    left = _Left(tasks)
    with _quiet():
        while not left.done:
            with _connected(cluster, workers) as client:
                yield from _until_lost(client, left, ahead)


class _Left:
    """The chunks that are still to be computed.

    Attributes:
        again: chunks that were lost.
        done: whether no chunk is left.
    """

    def __init__(self, tasks: Iterator[Chunk]) -> None:
        self.again: list[Chunk] = []
        self.done, self._tasks, self._losses = False, tasks, 0

    def next(self) -> Chunk | None:
        """Return a chunk; None if all have been submitted or computed."""
        return self.again.pop() if self.again else next(self._tasks, None)

    def won(self) -> None:
        """Reset the count of lost chunks after one that was computed."""
        self._losses = 0

    def lost(self, tasks: list[Chunk], cause: BaseException) -> None:
        """Take back the chunks that a cluster lost.

        Raises:
            ResultError: too many losses in succession.
        """
        self.again += tasks
        self._losses += 1
        if self._losses > MOST_LOSSES:
            raise ResultError(
                f"sweep: the cluster lost its chunks {self._losses} times without finishing one"
                f" ({type(cause).__name__}); what is finished is kept; try a smaller `chunk` if memory ran out"
            ) from cause


def _until_lost(client: Any, left: _Left, ahead: int) -> Iterator[Computed]:
    """Yield the results of chunks until all are computed (`left.done`) or the scheduler is gone."""
    distributed = require_dask()
    at_work: dict[
        Any, Chunk
    ] = {}  # Dask's executor forgets a future whose result is on its way when the scheduler dies
    while True:
        try:
            while len(at_work) < ahead and (task := left.next()) is not None:
                at_work[client.submit(compute, task, pure=False)] = task
            if not at_work:
                left.done = True
                return
            with client.as_current():
                ready = distributed.wait(list(at_work), return_when="FIRST_COMPLETED").done
            found = [(at_work[future], _result(future)) for future in ready]
        except (CancelledError, OSError) as cause:  # all futures are lost with their scheduler
            left.lost(list(at_work.values()), cause)
            return
        for future in ready:
            del at_work[future]
        for task, one in found:
            if isinstance(one, Computed):
                left.won()
                yield one
            else:
                left.lost([task], one)


def _result(future: Any) -> Computed | BaseException:
    """Return the result of a chunk, or the error if its workers died repeatedly.

    Raises:
        HoldfastError: the chunk was refused, or its worker lacks a package.
        CancelledError, OSError: the scheduler is gone.
    """
    try:
        return future.result()
    except require_dask().scheduler.KilledWorker as cause:
        return cause
    except (HoldfastError, CancelledError, OSError):
        raise
    except Exception as cause:
        raise ResultError(
            f"sweep: a chunk failed on the cluster: {type(cause).__name__}: {one_line(str(cause), 300)}; its workers"
            " need holdfast in the same version"
        ) from cause


@contextlib.contextmanager
def _connected(cluster: str, workers: int) -> Iterator[Any]:
    """Yield a client of a cluster that has a worker; a local cluster is closed with it.

    Raises:
        ResultError: there is no such cluster.
    """
    distributed = require_dask()
    import dask.config

    with contextlib.ExitStack() as ends:
        try:
            address: Any = cluster
            if cluster == LOCAL:
                scratch = ends.enter_context(tempfile.TemporaryDirectory(ignore_cleanup_errors=True))
                own = {"n_workers": workers, "threads_per_worker": 1, "local_directory": scratch}
                own |= {"dashboard_address": None, "worker_dashboard_address": None, "memory_limit": 0}
                ends.enter_context(dask.config.set(LOCAL_SETTINGS))
                with deaf_to_interrupts():
                    address = ends.enter_context(distributed.LocalCluster(silence_logs=logging.CRITICAL, **own))
            client = ends.enter_context(distributed.Client(address, timeout=CONNECTION_TIMEOUT, set_as_default=False))
            client.wait_for_workers(1, timeout=CONNECTION_TIMEOUT)
        except Exception as cause:  # any error of Dask's transports
            reason = one_line(str(cause), 200) or type(cause).__name__
            raise ResultError(
                f"cluster {one_line(cluster, 100)!r}: no scheduler with a worker answers ({reason}); what is finished"
                " is kept, and the same call goes on; try `dask scheduler` and `dask worker ADDRESS`, and"
                " `if __name__ == '__main__':` around the call in a script"
            ) from cause
        yield client


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Hide Dask's log of dead workers, and its advice on the size of chunks, from the user's terminal."""
    names = [name for name in logging.root.manager.loggerDict if name.startswith("distributed")]
    loggers = [logging.getLogger(name) for name in names]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", module="distributed")
        try:
            yield
        finally:
            for logger, level in zip(loggers, levels, strict=True):
                logger.setLevel(level)
