"""One chunk of a sweep: computation of its runs as a batch, and their results as the bytes of a Parquet file."""

from __future__ import annotations

import os
import pickle
import time
from collections import Counter
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from holdfast.errors import ResultError
from holdfast.io.columns import array_columns
from holdfast.io.save_run import meta_of
from holdfast.io.tables import pyarrow
from holdfast.progress import busy
from holdfast.simulation.rollout.record import RolloutRecord
from holdfast.simulation.rollout.rollout import Rollout
from holdfast.simulation.setting import Setting
from holdfast.spatial.scalar import Array
from holdfast.sweeps.plan import made_by


class Chunk(NamedTuple):
    """The data of a chunk for the process that computes it.

    Attributes:
        number: number of the chunk.
        begin: number of its first run.
        rollout: the pickled rollout.
        rows: arguments of `Rollout.start`.
        drawn: shapes, for one run, of the arguments that differ between runs, by name.
        run: further arguments of `Rollout.run`.
        outputs: names of the outputs to store.
        plan: digest of the plan.
        made_by: libraries and processor of the process that made the plan; see `made_by`.
    """

    number: int
    begin: int
    rollout: bytes
    rows: Mapping[str, Any]
    drawn: tuple[str, ...]
    run: Mapping[str, Any]
    outputs: tuple[str, ...]
    plan: str
    made_by: Mapping[str, Any]


class Computed(NamedTuple):
    """The results of a chunk.

    Attributes:
        number: number of the chunk.
        data: content of its file.
        status_counts: number of runs that ended with each status.
        seconds: time of the computation [s].
        process: id of the process that computed it.
    """

    number: int
    data: bytes
    status_counts: Counter[str]
    seconds: float
    process: int


_unpacked = lru_cache(maxsize=1)(pickle.loads)  # the last rollout of this process


def compute(task: Chunk, threads: int | None = 1) -> Computed:
    """Return the results of a chunk, which are the same bytes in every process.

    Args:
        task: the chunk.
        threads: as for `Rollout.run`; one by default, since other chunks are computed at the same time.

    Raises:
        ResultError: the libraries of this process differ from those of the process that made the plan.
    """
    start = time.perf_counter()
    if task.made_by != made_by():
        raise ResultError(
            f"sweep: expected workers with {_listed(task.made_by)}, on which the last bits depend, got one with"
            f" {_listed(made_by())}; try the same installation on all computers"
        )
    rollout: Rollout = _unpacked(task.rollout)
    with busy(False, "a chunk"):  # workers show nothing
        record = rollout.run(rollout.start(**task.rows, threads=threads), **task.run, threads=threads)
    data = encoded(columns_of(record, task), task.plan)
    counts = Counter(status.name for status in record.systems.status)
    return Computed(task.number, data, counts, time.perf_counter() - start, os.getpid())


def columns_of(record: RolloutRecord, task: Chunk) -> dict[str, Array]:
    """Return the columns of a chunk's file by title: the run, its end, the drawn values, and the outputs."""
    count, meta = len(record.systems), meta_of(Setting(record.systems.chain))
    found = {"run": np.arange(task.begin, task.begin + count)}
    found["status"] = np.array([status.name for status in record.systems.status])
    found["stopped [s]"] = record.stopped
    for name in task.drawn:
        found |= _titled(f"drawn {name}", np.asarray(task.rows[name]))
    for name in task.outputs:
        array = getattr(record.systems, name)
        titles = [column.title for column in array_columns(name, array.shape[1:], meta)]
        found |= dict(zip(titles, array.reshape(count, -1).T, strict=True))
    return found


def encoded(columns: Mapping[str, Array], plan: str) -> bytes:
    """Return columns as the bytes of a Parquet file whose metadata contain the digest of the plan.

    Raises:
        MissingExtra: pyarrow is not installed.
    """
    arrow, parquet = parquet_modules()
    table = arrow.table({title: np.ascontiguousarray(x) for title, x in columns.items()})
    sink = arrow.BufferOutputStream()
    parquet.write_table(table.replace_schema_metadata({"plan": plan}), sink)
    return sink.getvalue().to_pybytes()


def parquet_modules() -> tuple[Any, Any]:
    """Return pyarrow and its Parquet module.

    Raises:
        MissingExtra: pyarrow is not installed.
    """
    return pyarrow("sweeps keep their results in Parquet; try pip install 'holdfast[parquet]'")


def _titled(name: str, rows: Array) -> dict[str, Array]:
    """Return a column for each entry of a parameter, with indices in brackets in its title."""
    places = [f"[{','.join(map(str, at))}]" if at else "" for at in np.ndindex(rows.shape[1:])]
    return {f"{name}{place}": x for place, x in zip(places, rows.reshape(len(rows), -1).T, strict=True)}


def _listed(made: Mapping[str, Any]) -> str:
    """Return libraries and processor as text."""
    return ", ".join([*(f"{name} {number}" for name, number in made["versions"].items()), made["processor"]])
