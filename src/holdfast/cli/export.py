"""`holdfast export`: a result folder in; tables for other programs out."""

from __future__ import annotations

import os
from pathlib import Path

from holdfast.cli import complain
from holdfast.cli.console import stdout
from holdfast.cli.recorded import scenario_of
from holdfast.errors import ResultError
from holdfast.interop.mcap_writer import write_mcap
from holdfast.io.export import export_csv, export_parquet, occurrences_path
from holdfast.io.files import require_file
from holdfast.io.result_reader import Result, load_result


def _export_mcap(result: Result, path: Path, trust_xacro: bool) -> list[Path]:
    scenario = scenario_of(result, trust_xacro)
    write_mcap(scenario.chain, result.trajectory, path, scenario.options.get("base_motion"))
    return [path]


def export(folder: Path, format: str, out: Path | None, overwrite: bool, trust_xacro: bool) -> int:
    """Write a run as tables; say on stderr what is missing of an incomplete run.

    Args:
        folder: the result folder.
        format: csv, parquet, or mcap (ROS 2 messages).
        out: the file to write; `trajectory.<format>` in the result folder if None.
        overwrite: replace an existing file.
        trust_xacro: expand xacro files of a result that keeps no robots.

    Returns:
        0.

    Raises:
        ResultError: no result, or a file in the way.
        MissingExtra: Parquet without pyarrow, MCAP without mcap-ros2-support.
    """
    result = load_result(folder)
    path = folder / f"trajectory.{format}" if out is None else out
    require_file(path)
    taken = [one for one in (path, occurrences_path(path)) if os.path.lexists(one)]
    if taken and not overwrite:
        raise ResultError(f"{taken[0]}: is there already; try --overwrite, or another --out")
    if format == "mcap":
        written = _export_mcap(result, path, trust_xacro)
    else:
        written = {"csv": export_csv, "parquet": export_parquet}[format](result, path)
    if result.note:
        complain(f"{folder}: {result.note}")
    stdout().print(f"{path}: {result.samples} samples", soft_wrap=True)
    for log in written[1:]:
        stdout().print(f"{log}: what happened at single instants", soft_wrap=True)
    return 0
