"""The folder of a sweep.

    sweep.json             the manifest: the plan, its digest, versions
    runs_000000.parquet    the runs of a chunk, one per row
    log.jsonl              one line per chunk: time, process and duration of its computation
    lock                   locked by the process that writes to the folder
    scene.toml             text of the scene, for the sweep of a scene
    robot_*.urdf           robots that the scene takes from files, with xacro expanded
    robots.json            the arms and the robot files to which they belong

The file of a chunk is written under another name and then moved, so that a file that exists is complete.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from holdfast.errors import ResultError
from holdfast.io.files import LONGEST_NAME, one_line, read_bounded, reason_of, write_atomically
from holdfast.sweeps.chunk import Computed, parquet_modules
from holdfast.sweeps.plan import Plan, digest_of

MANIFEST, LOG, LOCK = "sweep.json", "log.jsonl", "lock"
FORMAT, FORMAT_VERSION = "holdfast-sweep", 1
LARGEST_MANIFEST = 16 * 2**20  # bytes


class Store:
    """A sweep's folder, locked while it is open for writing.

    Attributes:
        folder: path of the folder.
        digest: digest of the plan.
        generic_rank: the generic rank that the first call found; None in a new folder.
    """

    def __init__(self, folder: Path, plan: Plan) -> None:
        """Open or create the folder of a plan.

        Raises:
            ResultError: the folder contains results of another plan or other files, is in use, or cannot be written.
        """
        description = json.loads(json.dumps(plan.description()))
        self.folder, self.digest = folder, digest_of(description)
        self._made = not os.path.exists(folder)
        self._written = [] if os.path.exists(folder / LOCK) else [LOCK]
        self._lock = _locked(folder)
        try:
            found = _manifest(folder)
            own = (LOCK, f"{MANIFEST}.part")  # the second if a process died while it wrote its first file
            if found is None and any(path.name not in own for path in folder.iterdir()):
                raise ResultError(f"{folder}: expected a sweep's folder or an empty one, got other files; try another")
            if found is not None:
                _require_same(folder, found["plan"], description)
            self.generic_rank: int | None = None if found is None else found["generic_rank"]
        except BaseException:
            self.withdraw()
            self.close()
            raise
        self._description = description

    def settle(self, generic_rank: int) -> None:
        """Write the manifest of a new folder.

        Raises:
            ResultError: the file cannot be written.
        """
        self.generic_rank = generic_rank
        content = {
            "format": FORMAT,
            "format_version": FORMAT_VERSION,
            "plan_sha256": self.digest,
            "generic_rank": generic_rank,
            "plan": self._description,
        }
        write_atomically(self.folder / MANIFEST, json.dumps(content, indent=2).encode() + b"\n")
        self._written.append(MANIFEST)

    def keep_beside(self, files: Mapping[str, bytes]) -> None:
        """Write additional files that do not exist yet; they are the same for every call of a plan.

        Raises:
            ResultError: a file cannot be written.
        """
        for name, content in files.items():
            if not (self.folder / name).exists():
                write_atomically(self.folder / name, content)
                self._written.append(name)

    def holds(self, k: int, rows: int) -> bool:
        """Return whether there is a readable file of chunk k that belongs to this plan."""
        arrow, parquet = parquet_modules()
        try:
            meta = parquet.read_metadata(chunk_path(self.folder, k))
        except (OSError, arrow.ArrowException):
            return False
        return meta.num_rows == rows and (meta.metadata or {}).get(b"plan") == self.digest.encode()

    def keep(self, computed: Computed) -> None:
        """Write the file of a chunk, then a line of the log.

        Raises:
            ResultError: a file cannot be written.
        """
        write_atomically(chunk_path(self.folder, computed.number), computed.data)
        line = {"chunk": computed.number, "seconds": computed.seconds, "process": computed.process, "at": time.time()}
        try:
            with (self.folder / LOG).open("a", encoding="utf-8") as log:
                log.write(json.dumps(line) + "\n")
        except OSError as cause:
            raise ResultError(f"{self.folder / LOG}: cannot be written: {reason_of(cause)}") from cause

    def withdraw(self) -> None:
        """Remove a new folder and its files if the call was refused before any run was computed."""
        if LOCK not in self._written or any(self.folder.glob("runs_*")):
            return
        with suppress(OSError):
            for name in self._written:
                (self.folder / name).unlink(missing_ok=True)
            if self._made:
                self.folder.rmdir()

    def close(self) -> None:
        """Release the lock."""
        self._lock.close()


def stored_rank(folder: Path, plan: Plan) -> int:
    """Return the generic rank that a folder stores for a plan, without writing anything.

    Raises:
        ResultError: the folder contains no sweep, or one of another plan.
    """
    found = _manifest(folder)
    if found is None:
        raise ResultError(f"{folder}: has no {MANIFEST}; expected the folder of a sweep")
    _require_same(folder, found["plan"], json.loads(json.dumps(plan.description())))
    return found["generic_rank"]


def chunk_path(folder: Path, k: int) -> Path:
    """Return the file of chunk k."""
    return folder / f"runs_{k:06d}.parquet"


def _locked(folder: Path) -> IO[bytes]:
    """Create the folder if necessary and return its lock, which the system releases whenever this process ends.

    Raises:
        ResultError: another process holds the lock, or the folder cannot be created.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / LOCK).open("ab")
    except (OSError, ValueError) as cause:  # ValueError: the path is invalid
        reason = reason_of(cause) if isinstance(cause, OSError) else str(cause)
        raise ResultError(f"{one_line(str(folder), LONGEST_NAME)}: cannot be written: {reason}") from cause
    try:
        if os.name == "nt":
            import msvcrt

            msvcrt.locking(lock.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as cause:
        lock.close()
        raise ResultError(f"{folder}: another process writes this sweep; wait for it, or try another folder") from cause
    return lock


def _manifest(folder: Path) -> dict[str, Any] | None:
    """Return the manifest; None if there is none.

    Raises:
        ResultError: the file is not a manifest.
    """
    path = folder / MANIFEST
    if not path.exists():
        return None
    try:
        found = json.loads(read_bounded(path, LARGEST_MANIFEST))
        sound = isinstance(found["plan"], dict) and isinstance(found["generic_rank"], int)
        if (found["format"], found["format_version"], sound) != (FORMAT, FORMAT_VERSION, True):
            raise KeyError("format")
    except OSError as cause:
        raise ResultError(f"{path}: cannot be read: {reason_of(cause)}") from cause
    except (ValueError, KeyError, TypeError, RecursionError) as cause:
        raise ResultError(
            f"{path}: expected a manifest of a sweep, format {FORMAT_VERSION}; try another folder"
        ) from cause
    return found


def _require_same(folder: Path, there: Mapping[str, Any], requested: Mapping[str, Any]) -> None:
    """Refuse a folder that belongs to another plan.

    Raises:
        ResultError: the plans differ; the message names the differences.
    """
    differing = sorted(name for name in {*there, *requested} if there.get(name) != requested.get(name))
    if differing:
        raise ResultError(
            f"{folder}: holds a sweep of another plan: {', '.join(differing)} differ; try another folder, or the"
            " original arguments"
        )
