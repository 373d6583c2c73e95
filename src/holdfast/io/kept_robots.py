"""The robots' URDFs in a result folder: what was simulated, with xacro expanded, so that nothing is expanded again."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from holdfast.errors import ResultError
from holdfast.io.result_meta import ResultMeta, RobotRecord, read_bytes, sha256
from holdfast.robots.urdf.source import Source


def kept_files(sources: Mapping[str, Source]) -> tuple[dict[str, RobotRecord], dict[str, bytes]]:
    """Return what meta.json says of the robots, by arm, and the files to write; arms of one robot share one."""
    records, files = {}, {}
    for arm, source in sources.items():
        content = source.text.encode("utf-8") if isinstance(source.text, str) else source.text
        digest = sha256(content)
        folder = "" if source.folder is None else str(source.folder.resolve())
        records[arm] = RobotRecord(f"robot_{digest[:16]}.urdf", digest, folder)
        files[records[arm].file] = content
    return records, files


def kept_robots(folder: Path, meta: ResultMeta) -> dict[str, Source]:
    """Return the URDF of each arm that is out of a file, as it was simulated.

    Raises:
        ResultError: one is missing, or is not the one that was simulated.
    """
    found = {}
    for arm, record in meta.robots.items():
        path = folder / record.file
        content = read_bytes(path)
        if sha256(content) != record.sha256:
            raise ResultError(f"{path}: expected the robot that was simulated, got another text")
        found[arm] = Source(str(path), content, Path(record.folder) if record.folder else None)
    return found
