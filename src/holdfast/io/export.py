"""A run as tables for other programs: CSV for all of them, Parquet for large ones."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Iterator
from os import PathLike
from pathlib import Path
from typing import IO, Any

import numpy as np

from holdfast.errors import ResultError
from holdfast.io.columns import TEXTS, Cell, Column, columns, occurrence_columns, occurrence_row, rows
from holdfast.io.files import file_path, remove, write_atomically
from holdfast.io.result_meta import ResultMeta
from holdfast.io.result_reader import Result
from holdfast.io.save_run import meta_of
from holdfast.io.table_reader import pyarrow
from holdfast.simulation.trajectory import Trajectory, require_run_of
from holdfast.spatial.scalar import Array

Parts = Callable[[], Iterable[Trajectory]]  # the pieces of a run
Rows = Array | list[list[Cell]]
# (file, titles and units, blocks of rows) -> None: writes one table
TableWriter = Callable[[IO[bytes], list[Column], Iterable[Rows]], None]


def export_csv(result: Result | Trajectory, path: str | PathLike[str]) -> list[Path]:
    """Write a run as CSV with a header line and one row per sample, and return the files written.

    Columns are named `array entry [unit]`, such as `q left/joint1 [rad]` or `object_pose qw`. Numbers have enough
    digits to restore the same float64. Events of the run, if there are any, go to a second file,
    `occurrences_path(path)`. One chunk is in memory at a time.

    Args:
        result: the result of `simulate` or `load_result`.
        path: the file, which is replaced if it exists.

    Raises:
        ResultError: a file cannot be written, or the result can no longer be read.
        StateError: the run does not contain its chain, or has no samples.
    """
    return _export(*_source(result), path, _write_csv)


def export_parquet(result: Result | Trajectory, path: str | PathLike[str]) -> list[Path]:
    """Write a run as Parquet with the tables of `export_csv`, and return the files written.

    The unit of a column is part of its title, and is also stored in its metadata as `unit`. Every chunk is a row group.

    Args:
        result: the result of `simulate` or `load_result`.
        path: the file, which is replaced if it exists.

    Raises:
        MissingExtra: pyarrow is not installed.
        ResultError: a file cannot be written, or the result can no longer be read.
        StateError: the run does not contain its chain, or has no samples.
    """
    arrow, parquet = pyarrow()

    meta, parts = _source(result)

    def write(file: IO[bytes], head: list[Column], blocks: Iterable[Rows]) -> None:
        kinds = [arrow.string() if column.name in TEXTS else arrow.float64() for column in head]
        fields = [arrow.field(c.title, kind, metadata={"unit": c.unit}) for c, kind in zip(head, kinds, strict=True)]
        schema = arrow.schema(fields, metadata={"scene": meta.scene, **meta.versions})
        with parquet.ParquetWriter(file, schema) as table:
            for block in blocks:
                by_column = np.ascontiguousarray(block.T) if isinstance(block, np.ndarray) else zip(*block, strict=True)
                entries = [arrow.array(given, kind) for given, kind in zip(by_column, kinds, strict=True)]
                table.write_table(arrow.Table.from_arrays(entries, schema=schema))

    return _export(meta, parts, path, write)


def occurrences_path(path: Path) -> Path:
    """Return the file of the second table: `run_occurrences.csv` beside `run.csv`."""
    return path.with_name(f"{path.stem}_occurrences{path.suffix}")


def _export(meta: ResultMeta, parts: Parts, given: str | PathLike[str], write: TableWriter) -> list[Path]:
    path = file_path(given, "path")
    log = occurrences_path(path)
    happened: list[list[Cell]] = []

    def blocks() -> Iterator[Rows]:
        for part in parts():
            happened.extend(occurrence_row(one, meta) for one in part.occurrences)
            yield rows(part)

    head = columns(meta, next(iter(parts())))
    write_atomically(path, lambda file: write(file, head, blocks()))
    if not happened:
        remove(log)  # from an earlier export
        return [path]
    write_atomically(log, lambda file: write(file, occurrence_columns(meta), [happened]))
    return [path, log]


def _source(run: Any) -> tuple[ResultMeta, Parts]:
    """Return the metadata and the pieces of a run.

    Raises:
        ResultError: `result` is not a run.
        StateError: the run does not contain its chain, or has no samples.
    """
    if isinstance(run, Result):
        return run.meta, run.parts
    if isinstance(run, Trajectory):
        setting = run.require_setting()
        require_run_of(setting.chain, run)
        return meta_of(setting), lambda: [run]
    raise ResultError(
        "expected a run, as simulate(...) or load_result(folder) returns it, got a"
        f" {type(run).__name__}{'. Try load_result of it' if isinstance(run, str | PathLike) else ''}"
    )


def _write_csv(file: IO[bytes], head: list[Column], blocks: Iterable[Rows]) -> None:
    text = io.TextIOWrapper(file, encoding="utf-8", newline="")
    table = csv.writer(text, lineterminator="\n")
    table.writerow([column.title for column in head])
    for block in blocks:
        table.writerows(block.tolist() if isinstance(block, np.ndarray) else block)
    text.detach()
