"""The folder of a sweep.

    sweep.json             the manifest: the plan, its digest, versions
    runs_000000.parquet    a chunk's runs, a row each
    log.jsonl              when which process computed what, a line a chunk
    lock                   held by the process that writes here
    scene.toml             of a scene's sweep: its text
    robot_*.urdf           the robots that it takes from files, xacro expanded
    robots.json            which arm is out of which of them

Every chunk's file is moved into its place whole, so that one that is there is right, and one that is not is computed.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from holdfast.errors import ResultError
from holdfast.io.files import LONGEST_NAME, one_line, read_bounded, reason_of, write_atomically
from holdfast.sweeps.chunk import Computed, pyarrow
from holdfast.sweeps.plan import Plan, digest_of

MANIFEST, LOG, LOCK = "sweep.json", "log.jsonl", "lock"
FORMAT, FORMAT_VERSION = "holdfast-sweep", 1
LARGEST_MANIFEST = 16 * 2**20  # [bytes]


class Store:
    """A sweep's folder, locked while it is open for writing.

    Attributes:
        folder: its path.
        digest: of the plan.
        generic_rank: as the first call found it; None in a new folder.
    """

    def __init__(self, folder: Path, plan: Plan) -> None:
        """Open or make the folder of a plan.

        Raises:
            ResultError: it has another plan's results, something else, or is in use; or cannot be written.
        """
        description = json.loads(json.dumps(plan.description()))
        self.folder, self.digest = folder, digest_of(description)
        self._made = not os.path.exists(folder)
        self._written = [] if os.path.exists(folder / LOCK) else [LOCK]
        self._lock = _locked(folder)
        try:
            found = _manifest(folder)
            own = (LOCK, f"{MANIFEST}.part")  # the second where one died at its first file
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
            ResultError: it cannot be written.
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
        """Write files that are not there yet; they are the same for every call of a plan.

        Raises:
            ResultError: they cannot be written.
        """
        for name, content in files.items():
            if not (self.folder / name).exists():
                write_atomically(self.folder / name, content)
                self._written.append(name)

    def holds(self, k: int, rows: int) -> bool:
        """Return whether chunk k is there and whole: a file that cannot be read, or is of another plan, is not."""
        arrow, parquet = pyarrow()
        try:
            meta = parquet.read_metadata(chunk_path(self.folder, k))
        except (OSError, arrow.ArrowException):
            return False
        return meta.num_rows == rows and (meta.metadata or {}).get(b"plan") == self.digest.encode()

    def keep(self, computed: Computed) -> None:
        """Write a chunk's file, then a line of the log.

        Raises:
            ResultError: they cannot be written.
        """
        write_atomically(chunk_path(self.folder, computed.number), computed.data)
        line = {"chunk": computed.number, "seconds": computed.seconds, "process": computed.process, "at": time.time()}
        try:
            with (self.folder / LOG).open("a", encoding="utf-8") as log:
                log.write(json.dumps(line) + "\n")
        except OSError as cause:
            raise ResultError(f"{self.folder / LOG}: cannot be written: {reason_of(cause)}") from cause

    def withdraw(self) -> None:
        """Take away what a call wrote in a new folder, and that, if it was refused before any run was computed."""
        if LOCK not in self._written or any(self.folder.glob("runs_*")):
            return
        with suppress(OSError):
            for name in self._written:
                (self.folder / name).unlink(missing_ok=True)
            if self._made:
                self.folder.rmdir()

    def close(self) -> None:
        """Let others write here."""
        self._lock.close()


def stored_rank(folder: Path, plan: Plan) -> int:
    """Return the generic rank that a folder has for a plan; nothing is written.

    Raises:
        ResultError: the folder has no sweep, or another plan's.
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
    """Make the folder if need be and return its lock, which the system lets go when this process ends, however it does.

    Raises:
        ResultError: another process holds it, or the folder cannot be made.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / LOCK).open("ab")
    except (OSError, ValueError) as cause:  # ValueError: a path that no file system takes
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
    """Return the manifest, None if there is none.

    Raises:
        ResultError: it is not one.
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
    """Refuse a folder of another plan.

    Raises:
        ResultError: naming what differs.
    """
    differing = sorted(_differences(there, requested))
    if differing:
        raise ResultError(
            f"{folder}: holds a sweep of another plan: {', '.join(differing)} differ; try another folder, or the"
            " arguments of then"
        )


def _differences(a: Mapping[str, Any], b: Mapping[str, Any]) -> Iterator[str]:
    for name in {*a, *b}:
        if a.get(name) != b.get(name):
            yield name
