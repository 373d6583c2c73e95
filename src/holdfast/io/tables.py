"""Runs and records as tables for other programs: CSV, Parquet, pandas and xarray."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import IO, Any

import numpy as np

from holdfast.errors import MissingExtra, ResultError
from holdfast.io.columns import (
    NO_UNIT,
    TEXTS,
    Cell,
    TableColumn,
    array_columns,
    columns,
    occurrence_columns,
    occurrence_row,
    rows,
)
from holdfast.io.files import file_path, remove, write_atomically
from holdfast.io.result_meta import ResultMeta
from holdfast.io.result_reader import Result
from holdfast.io.save_run import meta_of
from holdfast.questions.arrays import Row, Shape
from holdfast.simulation.rollout.record import RolloutRecord
from holdfast.simulation.setting import Setting
from holdfast.simulation.trajectory import RUN_ARRAYS, Trajectory, require_run_of
from holdfast.spatial.scalar import Array

Parts = Callable[[], Iterable[Trajectory]]  # the pieces of a run
TableRows = Array | list[list[Cell]]
# (file, titles and units, blocks of rows) -> None: writes one table
TableWriter = Callable[[IO[bytes], list[TableColumn], Iterable[TableRows]], None]


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

    def write(file: IO[bytes], head: list[TableColumn], blocks: Iterable[TableRows]) -> None:
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

    def blocks() -> Iterator[TableRows]:
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


def _write_csv(file: IO[bytes], head: list[TableColumn], blocks: Iterable[TableRows]) -> None:
    text = io.TextIOWrapper(file, encoding="utf-8", newline="")
    table = csv.writer(text, lineterminator="\n")
    table.writerow([column.title for column in head])
    for block in blocks:
        table.writerows(block.tolist() if isinstance(block, np.ndarray) else block)
    text.detach()


def frame_of_run(run: Trajectory) -> Any:
    """Return a run as a pandas DataFrame, the table of `export_csv`.

    Raises:
        MissingExtra: pandas is not installed.
        StateError: the run does not contain its chain.
    """
    meta = meta_of(run.require_setting())
    return _library("pandas").DataFrame(rows(run), columns=[column.title for column in columns(meta, run)])


def data_set_of_run(run: Trajectory) -> Any:
    """Return a run as an xarray Dataset: its arrays over `t`, joints and arms by name, each with its unit.

    Raises:
        MissingExtra: xarray is not installed.
        StateError: the run does not contain its chain.
    """
    meta = meta_of(run.require_setting())
    arrays = {name: getattr(run, name) for name in run.recorded if name != "t"}
    return _data_set(arrays, {"t": run.t}, meta)


def frame_of_record(record: RolloutRecord) -> Any:
    """Return a record as a pandas DataFrame: a row for each system and time, which index it.

    Raises:
        MissingExtra: pandas is not installed.
    """
    pandas, meta = _library("pandas"), _meta_of_record(record)
    times, count = len(record.t), len(record.systems)
    by_title = {}
    for name, array in record.arrays.items():
        titles = [column.title for column in array_columns(name, array.shape[2:], meta)]
        entries = np.moveaxis(array, 0, 1).reshape(count * times, -1).T
        by_title |= dict(zip(titles, entries, strict=True))
    index = pandas.MultiIndex.from_product([range(count), record.t], names=["system", "t [s]"])
    return pandas.DataFrame(by_title, index=index)


def data_set_of_record(record: RolloutRecord) -> Any:
    """Return a record as an xarray Dataset: its arrays over `t` and `system`, joints and arms by name.

    Raises:
        MissingExtra: xarray is not installed.
    """
    over = {"t": record.t, "system": np.arange(len(record.systems))}
    found = _data_set({k: x for k, x in record.arrays.items() if x.dtype != object}, over, _meta_of_record(record))
    status = ("system", [status.name for status in record.systems.status])
    return found.assign_coords(status=status, stopped=("system", record.stopped))


def _data_set(arrays: Mapping[str, Array], over: Mapping[str, Array], meta: ResultMeta) -> Any:
    xarray = _library("xarray")
    coordinates: dict[str, Any] = {**over, "joint": meta.joints, "arm": meta.arms}
    variables = {}
    for name, array in arrays.items():
        row, shape = RUN_ARRAYS.get(name), array.shape[len(over) :]
        called = f"{name}_of_system" if name in over else name
        said = {"unit": "SI"} if row is None else {"unit": _unit(row), "long_name": row.meaning}
        variables[called] = ((*over, *_axes(name, shape, coordinates)), array, said)
    return xarray.Dataset(variables, coordinates)


def _axes(name: str, shape: Shape, coordinates: Mapping[str, Any]) -> list[str]:
    """Return the names of an array's axes after time and system."""
    axes = RUN_ARRAYS[name].axes if name in RUN_ARRAYS else ()
    along = None if callable(axes) or not axes else {"n": "joint", "arms": "arm"}.get(str(axes[0]))
    if along and shape[:1] == (len(coordinates[along]),):
        return [along, "moment_force"][: len(shape)]
    return [f"{name}_{k}" for k in range(len(shape))]


def _unit(row: Row) -> str:
    """Return the unit of an array, or those of its entries."""
    return ", ".join(dict.fromkeys(unit or NO_UNIT for _, unit in row.entries)) or row.unit or NO_UNIT


def _meta_of_record(record: RolloutRecord) -> ResultMeta:
    return meta_of(Setting(record.systems.chain))


def _library(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError as cause:
        raise MissingExtra(f"this needs {name}; try pip install 'holdfast[{name}]'") from cause


def pyarrow(need: str = "Parquet needs pyarrow; try pip install 'holdfast[parquet]', or CSV") -> tuple[Any, Any]:
    """Return the modules `pyarrow` and `pyarrow.parquet`.

    Args:
        need: the message if it is not installed.

    Raises:
        MissingExtra: pyarrow is not installed.
    """
    try:
        import pyarrow as arrow  # pyright: ignore[reportMissingImports]
        from pyarrow import parquet  # pyright: ignore[reportMissingImports]
    except ImportError as cause:
        raise MissingExtra(need) from cause
    return arrow, parquet
