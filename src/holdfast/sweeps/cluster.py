"""Computation of chunks by a Dask cluster, on other computers or on this one, whose workers and scheduler may die.

Dask itself repeats the chunks of dead workers. The chunks of a dead scheduler are given to its successor at the same
address; a local cluster is started again.
"""

from __future__ import annotations

import contextlib
import logging
import tempfile
import warnings
from collections.abc import Iterator
from concurrent.futures import CancelledError
from typing import Any

from holdfast.errors import HoldfastError, MissingExtra, ResultError
from holdfast.io.files import one_line
from holdfast.sweeps.chunk import Chunk, Computed, compute
from holdfast.sweeps.workers import deaf_to_interrupts

LOCAL = "local"  # a cluster of this computer's processes
# settings of a local cluster: background work of Dask, which would take several per cent of a processor
LOCAL_SETTINGS = {
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "5s",
}
MOST_LOSSES = 10  # losses of chunks or of the scheduler without a computed chunk in between
CONNECTION_TIMEOUT = 30.0  # time to wait for a scheduler and its first worker [s]


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
        """Reset the count of losses, because a chunk was computed."""
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
