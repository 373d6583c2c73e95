"""Reader of tables: named columns of numbers in CSV, Parquet, NumPy and MCAP files."""

from __future__ import annotations

import csv
import os
import re
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path

import numpy as np

from holdfast.errors import ResultError
from holdfast.io.files import file_path, one_line, reason_of
from holdfast.io.mcap_columns import mcap_columns
from holdfast.io.tables import pyarrow
from holdfast.model import checks
from holdfast.spatial.scalar import Array

_NAME_AND_UNIT = re.compile(r"(.*\S)\s*[\[(]([^\[\]()]*)[\])]\s*", re.DOTALL)  # `q1 [rad]`, `q1 (rad)`


@dataclass(frozen=True, eq=False)
class NamedColumns:
    """Columns of a file by name, each with its unit if its title has one.

    Attributes:
        source: the file, for messages.
        numbers: (samples,) each column; NaN where a cell is empty.
        units: what stands in brackets behind a column's name.
        faults: what is wrong with columns that are not numbers; they are refused when they are asked for.
        lines: (samples,) the line of each sample in a text file; empty for files without lines.
    """

    source: str
    numbers: Mapping[str, Array]
    units: Mapping[str, str] = field(default_factory=dict)
    faults: Mapping[str, str] = field(default_factory=dict)
    lines: Sequence[int] = ()

    def __contains__(self, name: str) -> bool:
        return name in self.numbers or name in self.faults

    def names(self) -> list[str]:
        """Return the names of all columns."""
        return [*self.numbers, *self.faults]

    def parts(self, name: str) -> list[str]:
        """Return the columns of an array with several: those called `name 0`, `name 1` and so on."""
        found = [f"{name} 0"]
        while found[-1] in self:
            found.append(f"{name} {len(found)}")
        return found[:-1]

    def place(self, sample: int) -> str:
        """Return where a sample is, for messages."""
        return f"line {self.lines[sample]}" if len(self.lines) else f"sample {sample}"

    def column(self, name: str, gaps: bool = False) -> Array:
        """Return a column, (samples,).

        Args:
            name: its name, without the unit.
            gaps: whether entries may be missing, which are NaN then.

        Raises:
            ResultError: there is no such column, or it has an entry that is no finite number.
        """
        if name in self.faults:
            raise ResultError(f"{self.source}: {self.faults[name]}")
        if name not in self.numbers:
            raise ResultError(
                f"{self.source}: expected a column '{one_line(name, 80)}'."
                f"{checks.did_you_mean(name, self.names()) or self._listed()}"
            )
        found = self.numbers[name]
        wrong = np.isinf(found) if gaps else ~np.isfinite(found)
        if wrong.any():
            k = int(np.flatnonzero(wrong)[0])
            raise ResultError(
                f"{self.source}: {self.place(k)}, {name}: expected a finite number, got"
                f" {'none (empty or NaN)' if np.isnan(found[k]) else found[k]}; {int(wrong.sum())} of {len(found)} are"
                " so"
            )
        return found

    def _listed(self) -> str:
        """Return the first names of columns."""
        names = self.names()
        more = f" and {len(names) - 8} more" if len(names) > 8 else ""
        return f" It has {', '.join(one_line(name, 40) for name in names[:8]) or 'none'}{more}"


def read_table(path: str | PathLike[str]) -> NamedColumns:
    """Return the columns of a CSV, Parquet, NumPy or MCAP file.

    The first line of a CSV file has the titles; columns are separated by commas, semicolons or tabs. Columns of an
    .npz archive are its arrays; one of several columns `q` has those called `q 0`, `q 1` and so on. Those of an MCAP
    file are as in `mcap_columns`.

    Raises:
        ResultError: the file cannot be read, or is no table.
        MissingExtra: it is a Parquet or MCAP file, and the package that reads it is not installed.
    """
    path = file_path(path, "path")
    readers = {".csv": _read_csv, ".parquet": _read_parquet, ".npz": _read_npz, ".mcap": _read_mcap}
    if path.suffix.lower() not in readers:
        if not os.path.exists(path):  # Path.exists raises where a name is too long
            raise ResultError(f"{one_line(str(path), 80)}: no such file or folder")
        raise ResultError(
            f"{one_line(str(path), 80)}: expected a file that ends in {', '.join(readers)}, or a result folder"
        )
    try:
        return readers[path.suffix.lower()](path)
    except (OSError, ValueError) as cause:  # ValueError: a name that no file system takes
        raise ResultError(f"{one_line(str(path), 80)}: cannot be read: {reason_of(cause)}") from cause


def _read_csv(path: Path) -> NamedColumns:
    """Return the table in a CSV file."""
    if not path.stat().st_size:
        raise ResultError(f"{path}: expected a table, but the file is empty")
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            separator = _separator(file.readline())
            file.seek(0)
            reader = csv.reader(file, delimiter=separator)
            read = [(line, reader.line_num) for line in reader if line]
    except (UnicodeDecodeError, csv.Error) as cause:
        raise ResultError(
            f"{path}: expected a CSV table in UTF-8, got something else: {one_line(str(cause), 80)}; try to export it"
            " again as CSV (UTF-8)"
        ) from cause
    if len(read) < 2:
        raise ResultError(f"{path}: expected a line of column names and a line for each sample, got {len(read)} lines")
    head, body, lines = read[0][0], [line for line, _ in read[1:]], [number for _, number in read[1:]]
    if not head[-1].strip() and all(len(line) == len(head) and not line[-1].strip() for line in body):
        head, body = head[:-1], [line[:-1] for line in body]  # separators at the ends of lines
    if all(_is_number(title) for title in head):
        raise ResultError(f"{path}: line 1: expected column names, got numbers; try a first line such as 't [s],q1,q2'")
    for line, number in zip(body, lines, strict=True):
        if len(line) != len(head):
            commas = sum("," in cell for cell in line) if separator != "," else 0
            hint = "; decimal commas?" if len(line) == 2 * len(head) or commas else ""
            hint = hint or ("; the file may end within a line" if number == lines[-1] else "")
            raise ResultError(
                f"{path}: line {number}: expected {len(head)} entries, one for each column, got {len(line)}{hint}"
            )
    columns = dict(zip(_named(head, path), zip(*body, strict=True), strict=True))
    numbers, faults = dict[str, Array](), dict[str, str]()
    for name, cells in columns.items():
        try:
            numbers[name] = np.array([cell if cell and not cell.isspace() else "nan" for cell in cells], dtype=float)
        except ValueError:
            k = next(k for k, cell in enumerate(cells) if cell.strip() and not _is_number(cell))
            comma = " with a decimal point" if re.fullmatch(r"\s*[+-]?\d+,\d+\s*", cells[k]) else ""
            faults[name] = f"line {lines[k]}, {name}: expected a number{comma}, got '{one_line(cells[k], 40)}'"
    return NamedColumns(str(path), numbers, _units(head), faults, lines)


def _separator(first: str) -> str:
    """Return what separates the columns of a file whose first line is given."""
    return max(",;\t", key=first.count) if "," not in first else ","


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _named(titles: Sequence[str], source: Path) -> list[str]:
    """Return the names in titles; refuse one that is there twice."""
    names = [_split(title)[0] for title in titles]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        shown = one_line(twice[0], 80) or "'' (a column without a name)"
        raise ResultError(
            f"{one_line(str(source), 80)}: expected unique column names, got '{shown}' twice; try to rename one"
        )
    return names


def _units(titles: Sequence[str]) -> dict[str, str]:
    """Return the units in titles by name."""
    return {name: unit for name, unit in map(_split, titles) if unit}


def _split(title: str) -> tuple[str, str]:
    """Return name and unit of a title `q1 [rad]`."""
    found = _NAME_AND_UNIT.fullmatch(title)
    return (found[1].strip(), found[2].strip()) if found else (title.strip(), "")


def _read_parquet(path: Path) -> NamedColumns:
    """Return the table in a Parquet file."""
    arrow, parquet = pyarrow()
    try:
        table = parquet.read_table(path)
    except (arrow.ArrowException, ValueError) as cause:
        raise ResultError(f"{path}: expected a Parquet table: {one_line(str(cause), 200)}") from cause
    numbers, faults = dict[str, Array](), dict[str, str]()
    if not table.num_rows:
        raise ResultError(f"{path}: expected a row for each sample, got none")
    for name, title in zip(_named(table.column_names, path), table.column_names, strict=True):
        try:
            numbers[name] = table.column(title).to_numpy().astype(float)
        except (arrow.ArrowException, ValueError, TypeError):
            faults[name] = f"{name}: expected numbers, got {table.schema.field(title).type}"
    return NamedColumns(str(path), numbers, _units(table.column_names), faults)


def _read_npz(path: Path) -> NamedColumns:
    """Return the arrays of a NumPy archive, by name; single numbers in it are left out."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            if isinstance(archive, np.ndarray):
                raise ResultError(f"{path}: expected an archive of named arrays, got a single one; try np.savez")
            arrays, faults = dict[str, Array](), dict[str, str]()
            for name in archive.files:
                try:
                    array = archive[name]
                except ValueError:
                    faults[name] = f"{name}: expected an array of numbers, got Python objects"
                    continue
                if array.dtype.kind not in "fiub":
                    faults[name] = f"{name}: expected an array of real numbers, got {array.dtype}"
                elif array.ndim:
                    arrays[name] = array.astype(float)
    except (zipfile.BadZipFile, EOFError, KeyError, NotImplementedError, ValueError) as cause:
        raise ResultError(f"{path}: expected a NumPy archive, got something else; try np.savez") from cause
    if not arrays:
        raise ResultError(f"{path}: expected arrays with one entry or row for each sample, got none")
    lengths = [len(array) for array in arrays.values()]
    usual = max(set(lengths), key=lengths.count)
    columns = dict[str, Array]()
    for name, array in arrays.items():
        if len(array) != usual:
            faults[name] = f"{name}: expected {usual} samples, as other arrays have, got {len(array)}"
        elif array.ndim == 1:
            columns[name] = array
        else:
            columns |= {f"{name} {k}": x for k, x in enumerate(array.reshape(len(array), -1).T)}
    return NamedColumns(str(path), columns, {}, faults)


def _read_mcap(path: Path) -> NamedColumns:
    """Return the columns of an MCAP file."""
    return NamedColumns(str(path), *mcap_columns(path))
