"""Loading recordings from result folders, and from tables with the column titles of exports."""

from __future__ import annotations

from os import PathLike
from typing import Any

import numpy as np

from holdfast.errors import ResultError
from holdfast.identification.recording import FREE_BODIES, Recording
from holdfast.io.columns import array_columns
from holdfast.io.files import file_path, one_line, reason_of
from holdfast.io.result_reader import load_result
from holdfast.io.save_run import meta_of
from holdfast.io.table_reader import read_table
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.setting import Setting
from holdfast.simulation.trajectory import RUN_ARRAYS
from holdfast.state import Inputs


def load_recording(path: str | PathLike[str], chain: ClosedChain, *, inputs: Inputs | None = None) -> Recording:
    """Return the recording of a chain in a file.

    Tables have the column titles of `export_csv`: `t [s]`, `q left/joint1 [rad]`, `tau left/joint1 [N m]`,
    `wrist_wrench left moment_x [N m]`, `object_pose qw` and so on; units may be omitted. Other columns are ignored. If
    one column of an array is present, all of its columns are required.

    Args:
        path: a result folder, or a file that ends in .csv or .parquet.
        chain: the chain whose arms and joints are named in the titles.
        inputs: external wrenches and base motion of the recording, which files do not contain.

    Raises:
        ResultError: the file cannot be read, or lacks columns.
        StateError: the arrays are not a valid recording.
        MissingExtra: it is a Parquet file, and pyarrow is not installed.
    """
    checks.instance(chain, ClosedChain, "load_recording: chain")
    path = file_path(path, "path")
    try:
        folder = path.is_dir()
    except OSError as cause:  # a name that is too long
        raise ResultError(f"{one_line(str(path), 80)}: cannot be read: {reason_of(cause)}") from cause
    if folder:
        return Recording.of_run(load_result(path), inputs)
    table = read_table(path)
    if "t" not in table:
        raise ResultError(f"{path}: expected a column 't [s]'.{checks.did_you_mean('t', table)}")
    free = [f"{body}_{what}" for body in FREE_BODIES for what in ("pose", "twist", "acceleration")]
    meta, names = meta_of(Setting(chain)), ("q", "qd", "qdd", "tau", "wrist_wrench", *free[: 6 if chain.floats else 3])
    shapes = {name: RUN_ARRAYS[name].shape(chain) for name in names}
    titles = {name: [column.name for column in array_columns(name, shapes[name], meta)] for name in names}
    others = set(table) - {column for columns in titles.values() for column in columns}
    found: dict[str, Any] = {}
    for name, columns in titles.items():
        present = [column for column in columns if column in table]
        if not present and name != "q":
            continue
        if absent := [column for column in columns if column not in table]:
            raise ResultError(
                f"{path}: expected a column '{absent[0]}'.{checks.did_you_mean(absent[0], sorted(others))}"
            )
        found[name] = np.column_stack([table[column] for column in columns]).reshape(-1, *shapes[name])
    return Recording(table["t"], **found, inputs=inputs)


def recording_of(given: Any, chain: ClosedChain) -> Recording:
    """Return the recording in a `Recording`, a run, a result, or the file at a path."""
    if isinstance(given, Recording):
        return given
    return load_recording(given, chain) if isinstance(given, str | PathLike) else Recording.of_run(given)
