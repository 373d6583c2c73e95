"""The folder of a sweep.

sweep.json             the manifest: the plan, its digest, versions, and the chunks that are there
runs_000000.parquet    the runs of a chunk, one per row
log.jsonl              one line per chunk: its SHA-256, and time, process and duration of its computation
lock                   locked by the process that writes to the folder
scene.toml             text of the scene, for the sweep of a scene
robot_*.urdf           robots that the scene takes from files, with xacro expanded
robots.json            the arms and the robot files to which they belong

A chunk counts once sweep.json, replaced atomically, names it (`io.store`), or the log does.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from pathlib import Path
from typing import IO, Any

from msgspec.structs import replace

from holdfast.errors import ResultError
from holdfast.io.files import LONGEST_NAME, one_line, reason_of
from holdfast.io.result_meta import SCENE
from holdfast.io.store import UNREADABLE, Damage, FolderKind, Manifest, StoreWriter, read_manifest, stored
from holdfast.sweeps.chunk import Computed, parquet_modules
from holdfast.sweeps.plan import Plan, digest_of

LOG_FILE, LOCK_FILE, ROBOTS_FILE = "log.jsonl", "lock", "robots.json"
SWEEP = FolderKind(
    name="sweep",
    manifest="sweep.json",
    versions=(2, 1),
    chunk="runs_{:06d}.parquet",
    data=("runs_[0-9]*.parquet",),
    others=(LOG_FILE, LOCK_FILE, SCENE, ROBOTS_FILE, "robot_*.urdf"),
    again="call `sweep` again with the same arguments, or `holdfast sweep` with the scene, to recompute it",
)
COMMIT_INTERVAL = 5.0  # seconds between two commits; until then the log has the digests of further chunks


class SweepMeta(Manifest, frozen=True, kw_only=True):
    """The content of sweep.json.

    Attributes:
        plan_sha256: digest of the plan, which every chunk contains.
        generic_rank: the generic rank that the first call found.
        plan: description of the plan.
    """

    plan_sha256: str
    generic_rank: int
    plan: dict[str, Any]


class Store:
    """A sweep's folder, locked while it is open for writing.

    Attributes:
        folder: path of the folder.
        meta: its manifest; None in a new folder.
        plan_sha256: digest of the plan.
    """

    def __init__(self, folder: Path, plan: Plan) -> None:
        """Open or create the folder of a plan.

        Raises:
            ResultError: the folder contains results of another plan or other files, is of an earlier format or in use,
                or cannot be written.
        """
        self._description = plan.description()
        self.folder, self.plan_sha256 = folder, digest_of(self._description)
        self.meta: SweepMeta | None = None
        self._writer, self._committed_at = StoreWriter(folder, SWEEP), -float("inf")
        self._made = not os.path.exists(folder)
        self._written = [] if os.path.exists(folder / LOCK_FILE) else [LOCK_FILE]  # of a new folder
        self._lock = _locked(folder)
        try:
            if (found := self._found()) is not None:
                differences(folder, found, self._description)
                if found.format_version != SWEEP.versions[0]:
                    raise ResultError(f"{folder}: written by holdfast 0.1: can be read, but not continued; try another")
                self.meta, self._writer.files = found, _logged(folder) | found.files
        except BaseException:
            self.withdraw()
            self._lock.close()
            raise

    def _found(self) -> SweepMeta | None:
        """Return the manifest; None for a new folder, and for one of this plan that has lost its manifest.

        Raises:
            ResultError: the folder contains other files, or a damaged manifest and no chunk of this plan.
        """
        names = {path.name for path in self.folder.iterdir()} - {LOCK_FILE, f"{SWEEP.manifest}.part"}
        chunks = SWEEP.strays(self.folder, 0)
        if names and SWEEP.manifest not in names and not chunks:
            raise ResultError(f"{self.folder}: expected a sweep's folder or an empty one, got other files; try another")
        try:
            return read_manifest(self.folder, SWEEP, SweepMeta) if names else None
        except Damage:
            if not any(_plan_in(self.folder / name) == self.plan_sha256.encode() for name in chunks):
                raise
            return None

    def prepare(self, rank: Callable[[], int], files: Mapping[str, bytes]) -> SweepMeta:
        """Write the manifest of a new folder, and further files that are missing or damaged; return the manifest.

        Files that the manifest does not name are removed.

        Args:
            rank: returns the generic rank.
            files: contents of the further files by name, which are the same for every call of a plan.

        Raises:
            ResultError: a file cannot be written or removed.
        """
        self._written += [name for name in (SWEEP.manifest, *files) if not (self.folder / name).exists()]
        if self.meta is None:
            form: dict[str, Any] = {"format": SWEEP.format, "format_version": SWEEP.versions[0]}
            plan = {"plan_sha256": self.plan_sha256, "plan": self._description}
            self.meta = SweepMeta(**form, **plan, generic_rank=rank())
            self._writer.commit(self.meta)
        self._writer.keep(files)
        self.commit()
        self._writer.remove_unnamed((*SWEEP.data, "*.part"))
        return self.meta

    def holds(self, k: int) -> bool:
        """Return whether the file of chunk k is there, undamaged, and of this plan; reads it once."""
        name = SWEEP.chunk.format(k)
        try:
            stored(self.folder, name, self._writer.files, most=sys.maxsize)
        except Damage:
            return False
        return _plan_in(self.folder / name) == self.plan_sha256.encode()

    def keep(self, computed: Computed) -> None:
        """Write the file of a chunk, then a line of the log.

        Raises:
            ResultError: a file cannot be written.
        """
        name = SWEEP.chunk.format(computed.number)
        self._writer.write(name, computed.data)
        line = {"chunk": computed.number, "sha256": self._writer.files[name], "seconds": computed.seconds}
        line |= {"process": computed.process, "at": time.time()}
        try:
            with (self.folder / LOG_FILE).open("a", encoding="utf-8") as log:
                log.write(json.dumps(line) + "\n")
        except OSError as cause:
            raise ResultError(f"{self.folder / LOG_FILE}: cannot be written: {reason_of(cause)}") from cause
        if time.monotonic() - self._committed_at >= COMMIT_INTERVAL:
            self.commit()

    def commit(self) -> Mapping[str, str | None]:
        """Name all chunks that are there in the manifest, and return the digests of its files."""
        if self.meta is not None and self._writer.files != self.meta.files:
            self._writer.commit(self.meta)
            self.meta = replace(self.meta, files=dict(self._writer.files))
        self._committed_at = time.monotonic()
        return self._writer.files

    def withdraw(self) -> None:
        """Remove a new folder and its files if the call was refused before any run was computed."""
        if LOCK_FILE not in self._written or SWEEP.strays(self.folder, 0):
            return
        self.meta = None
        with suppress(OSError):
            for name in self._written:
                (self.folder / name).unlink(missing_ok=True)
            if self._made:
                self.folder.rmdir()

    def close(self) -> None:
        """Commit, and release the lock.

        Raises:
            ResultError: the manifest cannot be written.
        """
        try:
            self.commit()
        finally:
            self._lock.close()


def _locked(folder: Path) -> IO[bytes]:
    """Create the folder if necessary and return its lock, which the system releases whenever this process ends.

    Raises:
        ResultError: another process holds the lock, or the folder cannot be created.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / LOCK_FILE).open("ab")
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


def _logged(folder: Path) -> dict[str, str | None]:
    """Return the digests of chunks in the log, where those are that a crash kept out of the manifest."""
    found: dict[str, str | None] = {}
    with suppress(OSError):
        for line in (folder / LOG_FILE).read_bytes().splitlines():
            with suppress(ValueError, RecursionError, TypeError, KeyError, AttributeError):  # damage: computed again
                one = json.loads(line)
                found[SWEEP.chunk.format(one["chunk"])] = str(one["sha256"])
    return found


def _plan_in(path: Path) -> bytes | None:
    """Return the digest of the plan in the file of a chunk; None if it has none."""
    arrow, parquet = parquet_modules()
    try:
        return (parquet.read_metadata(path).metadata or {}).get(b"plan")
    except (*UNREADABLE, arrow.ArrowException):
        return None


def differences(
    folder: Path, meta: SweepMeta, description: Mapping[str, Any], tolerated: Collection[str] = ()
) -> list[str]:
    """Return the names of what differs between the plan of a folder and another one.

    Raises:
        ResultError: something else differs than what is tolerated.
    """
    found = sorted(name for name in {*meta.plan, *description} if meta.plan.get(name) != description.get(name))
    if others := [name for name in found if name not in tolerated]:
        raise ResultError(
            f"{folder}: holds a sweep of another plan: {', '.join(others)} differ; try another folder, or the original"
            " arguments"
        )
    return found
