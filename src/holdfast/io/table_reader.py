"""Reading the tables that `export_csv` and `export_parquet` write: the numbers of each column by its title."""

from __future__ import annotations

import csv
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.errors import MissingExtra, ResultError
from holdfast.io.files import file_path, one_line, reason_of
from holdfast.spatial.scalar import Array


def read_table(path: str | PathLike[str]) -> dict[str, Array]:
    """Return the columns of a CSV or Parquet file by title, units in brackets taken off, as floats.

    Args:
        path: a file that ends in .csv or .parquet; of a CSV the first line is the header.

    Raises:
        ResultError: the file cannot be read, or an entry is no number.
        MissingExtra: a Parquet file, and pyarrow is not installed.
    """
    path = file_path(path, "path")
    readers = {".csv": _read_csv, ".parquet": _read_parquet}
    if path.suffix.lower() not in readers:
        raise ResultError(
            f"{one_line(str(path), 80)}: expected a file that ends in {' or '.join(readers)}, or a result folder"
        )
    try:
        columns = readers[path.suffix.lower()](path)
    except (OSError, ValueError) as cause:  # ValueError: a name that no file system takes
        raise ResultError(f"{one_line(str(path), 80)}: cannot be read: {reason_of(cause)}") from cause
    return {title.partition(" [")[0].strip(): column for title, column in columns.items()}


def _read_csv(path: Path) -> dict[str, Array]:
    """Return the columns of a CSV file by title."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            lines = [line for line in csv.reader(file) if line]
    except (UnicodeDecodeError, csv.Error) as cause:
        raise ResultError(f"{path}: expected a CSV table in UTF-8, got something else") from cause
    if len(lines) < 2:
        raise ResultError(f"{path}: expected a line of column names and a line for each sample, got {len(lines)} lines")
    head, *body = lines
    if twice := {title for title in head if head.count(title) > 1}:
        raise ResultError(f"{path}: expected unique column names, got '{one_line(sorted(twice)[0])}' twice")
    for k, line in enumerate(body, 2):
        if len(line) != len(head):
            raise ResultError(f"{path}: line {k}: expected {len(head)} entries, one for each column, got {len(line)}")
        for title, entry in zip(head, line, strict=True):
            try:
                float(entry)
            except ValueError as cause:
                raise ResultError(
                    f"{path}: line {k}, {title}: expected a number, got '{one_line(entry, 40)}'"
                ) from cause
    return dict(zip(head, np.array(body, dtype=float).T, strict=True))


def _read_parquet(path: Path) -> dict[str, Array]:
    """Return the columns of a Parquet file by title."""
    arrow, parquet = pyarrow()
    try:
        table = parquet.read_table(path)
        return {title: table.column(title).to_numpy().astype(float) for title in table.column_names}
    except (arrow.ArrowException, ValueError) as cause:
        raise ResultError(f"{path}: expected a Parquet table of numbers: {one_line(str(cause), 200)}") from cause


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
