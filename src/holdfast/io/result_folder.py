"""Result folders: a run on disk, readable at any moment while it is written, and after any death of its writer.

    meta.json             the manifest: which run it is, and which samples and which checkpoint are there
    scene.toml            the scene's text
    robot_*.urdf          the robots that it takes from files, xacro expanded
    chunk_0000.npz        samples: the trajectory's arrays under their names
    checkpoint_0001.npz   the state after so many samples, from which an unfinished run is resumed
    summary.json          the numbers of the summary, written at the end
    model.json            the chain of a run made in Python, which has no scene
    bases.npz             the motion of the bases in such a run; bases_planned.npz until it has ended

A chunk counts once meta.json, replaced atomically, names it (`store`). docs/results.md is the format in full.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self

import numpy as np
from msgspec.structs import replace

from holdfast.errors import ResultError
from holdfast.io import result_meta
from holdfast.io.result_meta import RESULT, ResultMeta
from holdfast.io.store import CHANGED, StoreWriter, advising, arrays_text, json_text, read_arrays, require_free, sha256
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.fingerprint import fingerprint
from holdfast.model.grasp_rows import grasp_rows, row_name
from holdfast.robots.urdf.source import UrdfSource
from holdfast.simulation.balance import WORK_TERMS
from holdfast.simulation.checkpoint import Checkpoint
from holdfast.simulation.events import Occurrence
from holdfast.simulation.summary import Summary
from holdfast.simulation.trajectory import RUN_ARRAYS, Trajectory, stacked

CHUNK = 1000  # samples that wait until they are flushed
LONGEST_WAIT = 5.0  # seconds after which fewer are


class ResultWriter:
    """Writes one run; nothing is on disk before there is a sample.

    Attributes:
        folder: the folder.
        start: checkpoint from which a resumed run continues; None for a new run.
    """

    def __init__(
        self,
        folder: Path,
        meta: ResultMeta,
        scene_text: str,
        *,
        robots: Mapping[str, UrdfSource] | None = None,
        overwrite: bool = False,
        files: Mapping[str, bytes] | None = None,
        advice: str = "--resume, --overwrite, or another --out",
    ) -> None:
        """Check that the folder can be used.

        Args:
            folder: the folder; it is created if it does not exist.
            meta: what `run_meta` returns.
            scene_text: text of the scene file.
            robots: URDF of each arm that comes from a file, by arm.
            overwrite: replace an earlier result there.
            files: contents of further files by name.
            advice: what the error suggests if there is an earlier result.

        Raises:
            ResultError: the folder is in use.
        """
        require_free(folder, RESULT, overwrite, advice)
        self.folder, self._store = folder, StoreWriter(folder, RESULT)
        self.start: Checkpoint | None = None
        scene = scene_text.encode("utf-8")
        records, kept = result_meta.kept_files(robots or {})
        self._files = {result_meta.SCENE: scene, **kept, **(files or {})}
        self._meta = replace(meta, scene_sha256=sha256(scene), robots=records)
        self._waiting: list[Trajectory] = []
        self._reported = 0  # occurrences
        self._marked: tuple[int, Checkpoint] | None = None
        self._flushed_at = -np.inf  # so that the first sample goes to disk at once

    @classmethod
    def resume(
        cls, folder: Path, meta: ResultMeta, scene_text: str, *, robots: Mapping[str, UrdfSource] | None = None
    ) -> Self:
        """Return a writer that continues the run in a folder from its checkpoint, `start`.

        If the earlier writer died before its first flush, the run starts over, and `start` is None.

        Args:
            folder: folder of the run.
            meta: what `run_meta` returns now.
            scene_text: text of the scene file.
            robots: as for a new writer.

        Raises:
            ResultError: the run has ended, is damaged, is another one than this, or its
                controller's memory could not be written.
        """
        writer = cls(folder, meta, scene_text, robots=robots, overwrite=True)
        if (found := _resumed(folder, writer._meta)) is not None:
            writer._meta, writer.start, writer._store = found
            writer._store.keep({name: x for name, x in writer._files.items() if name in writer._store.files})
            writer._flushed_at = time.monotonic()
        return writer

    @property
    def samples(self) -> int:
        """Number of samples on disk."""
        return self._meta.samples

    def add(self, part: Trajectory) -> None:
        """Take a sample, or successive ones to the last of which belongs what has happened."""
        self._waiting.append(part if np.ndim(part.t) else stacked([part]))
        self._reported += len(part.occurrences)

    def mark(self, checkpoint: Checkpoint) -> None:
        """Take the checkpoint of the last sample, and flush if a flush is due."""
        self._marked = self.samples + self.waiting, checkpoint
        self.flush_if_due()

    @property
    def waiting(self) -> int:
        """Number of samples that are not on disk yet."""
        return sum(map(len, self._waiting))

    def flush_if_due(self) -> None:
        """Flush if many samples wait, if the last flush is long ago, or if none is on disk yet.

        Raises:
            ResultError: they cannot be written.
        """
        if self.waiting >= CHUNK or time.monotonic() - self._flushed_at >= LONGEST_WAIT:
            self.flush()

    def parts(self) -> Iterator[Trajectory]:
        """Yield the samples on disk chunk by chunk, one chunk in memory at a time.

        Raises:
            ResultError: the folder has changed.
        """
        meta = replace(self._meta, files=self._store.files)
        for k in range(len(meta.chunks)):
            with advising(self.folder, CHANGED):
                yield result_meta.read_chunk(self.folder, k, meta)

    def flush(self) -> None:
        """Write the waiting samples to disk; they are durable when this returns.

        A flush that failed can be repeated. It costs six waits for the disk.

        Raises:
            ResultError: it cannot be written, or another process has written to the folder.
        """
        if not self._waiting:
            return
        self._store.begin(self._meta, self._files)
        k, count = len(self._meta.chunks), self.waiting
        self._store.write(result_meta.chunk_name(k), result_meta.chunk_text(self._waiting))
        flushed = replace(
            self._with_checkpoint(),
            samples=self.samples + count,
            chunks=[*self._meta.chunks, count],
            last_time=float(self._waiting[-1].t[-1]),
        )
        self._commit(flushed)
        self._waiting = []
        self._flushed_at = time.monotonic()

    def finish(
        self,
        summary: Summary | None,
        *,
        stopped: str | None = None,
        occurrences: Sequence[Occurrence] = (),
        bases: bytes | None = None,
    ) -> None:
        """Write the remaining samples and record how the run ended.

        Args:
            summary: the numbers of `summary.json`; None to write no such file.
            stopped: the reason why the run ended early; None for a complete run. Only a run that was "interrupted" can
                be resumed.
            occurrences: all occurrences since the run began or was resumed. Those after the last sample are stored as
                the ones that ended it.
            bases: how bases moved, as the content of `bases.npz`, in place of what was planned.

        Raises:
            ResultError: A file cannot be written, or another process has written to the folder.
        """
        self.flush()
        if not self.samples:
            return
        self._store.begin(self._meta, {})
        if bases is not None:
            self._store.write(result_meta.BASES, bases)
        if summary is not None:
            self._store.write(result_meta.SUMMARY, json_text(asdict(summary)))
        last = list(occurrences[self._reported :])
        ended = replace(self._meta, complete=stopped is None, stopped=stopped, occurrences=last)
        planned = () if bases is None else (result_meta.PLANNED,)
        self._commit(replace(ended, checkpoint=None) if ended.ended else ended, planned)

    def _with_checkpoint(self) -> ResultMeta:
        """Return the meta that names the last checkpoint, after writing it."""
        if self._marked is None:
            return self._meta
        samples, checkpoint = self._marked
        try:
            arrays, data = checkpoint.to_data()
        except ResultError as cause:  # a memory that cannot be written is no reason to lose samples
            return replace(self._meta, checkpoint=None, no_checkpoint=str(cause))
        # each checkpoint has a name of its own, so that none is overwritten
        record = result_meta.CheckpointRecord(f"checkpoint_{samples:04d}.npz", samples)
        self._store.write(record.file, arrays_text(arrays, "data", data))
        return replace(self._meta, checkpoint=record)

    def _commit(self, meta: ResultMeta, drop: Sequence[str] = ()) -> None:
        """Replace meta.json, and delete the checkpoint that it no longer names."""
        old, new = self._meta.checkpoint, meta.checkpoint
        over = () if old is None or (new is not None and new.file == old.file) else (old.file,)
        self._store.commit(meta, (*drop, *over))
        self._meta = meta  # only now, so that a failed flush can be repeated


def _resumed(folder: Path, meta: ResultMeta) -> tuple[ResultMeta, Checkpoint, StoreWriter] | None:
    """Return the new metadata of a folder, the checkpoint from which its run continues, and the folder's writer.

    Samples after the checkpoint are dropped, because the run computes them again. Every chunk is read, one at a time.

    Args:
        folder: folder of the run.
        meta: metadata of the run that is to continue.

    Returns:
        None if nothing was flushed.

    Raises:
        ResultError: the run has ended, is damaged, or is another one.
    """
    if not (folder / result_meta.META).exists() and not RESULT.strays(folder, 0):
        return None
    found = result_meta.read_meta(folder)
    if not found.samples:
        return None
    _require_open(folder, found, meta)
    if found.checkpoint is None:
        raise ResultError(
            f"{folder}: cannot be resumed: {found.no_checkpoint or 'it has no checkpoint'}; try --overwrite"
        )
    with advising(folder, "it cannot be resumed; try --overwrite"):
        checkpoint = Checkpoint.from_data(*read_arrays(folder, found.checkpoint.file, found.files, "data"))
        kept = _up_to(found.checkpoint.samples, folder, found)
    store = StoreWriter(folder, RESULT, found.files)
    store.commit(kept, [*map(result_meta.chunk_name, range(len(kept.chunks), len(found.chunks))), result_meta.SUMMARY])
    store.remove_unnamed((*RESULT.data, "*.part"))
    return kept, checkpoint, store


def _require_open(folder: Path, found: ResultMeta, meta: ResultMeta) -> None:
    """Refuse a run that is another one, or that has ended."""
    if differ := result_meta.differences(found, meta):
        raise ResultError(
            f"{folder}: the run there cannot be resumed identically, since these differ: {', '.join(differ)};"
            " try the original ones, or --overwrite"
        )
    if found.format_version != RESULT.versions[0]:
        raise ResultError(f"{folder}: written by holdfast 0.1: it can be read, but not resumed; try --overwrite")
    if found.ended:
        how = found.stopped or f"the run is complete, {found.samples} samples up to t = {found.last_time:.6g} s"
        raise ResultError(f"{folder}: nothing to resume: {how}")


def _up_to(samples: int, folder: Path, meta: ResultMeta) -> ResultMeta:
    """Return the metadata of a run's first samples only.

    Raises:
        Damage: some of them are missing.
    """
    counts: list[int] = []
    last_time = None
    for k, count in enumerate(meta.chunks):
        left = min(count, samples - sum(counts))
        if left > 0:
            last_time = float(result_meta.read_chunk(folder, k, meta).t[left - 1])
            counts.append(left)
    return replace(meta, samples=sum(counts), chunks=counts, last_time=last_time, stopped=None, occurrences=[])


def run_meta(
    chain: ClosedChain, name: str, duration: float, step: float, *, scene_folder: str = "", **options: Any
) -> ResultMeta:
    """Return the content of meta.json before the first sample.

    Args:
        chain: the chain that is simulated.
        name: name of the scene.
        duration: requested duration [s].
        step: requested step [s].
        scene_folder: folder to which names of robot files in the scene are relative; "" if there are none.
        options: further settings on which the results depend, as plain data; a run is resumed only with equal ones.
    """
    from holdfast import __version__

    packages = {"holdfast": __version__, "numpy": np.__version__, "llvmlite": version("llvmlite")}
    return ResultMeta(
        format=RESULT.format,
        format_version=RESULT.versions[0],
        scene=name,
        scene_folder=scene_folder,
        model_sha256=fingerprint(chain),
        versions=packages | {"python": platform.python_version(), "processor": platform.machine()},
        arms=list(chain.names),
        trunk=chain.trunk is not None,
        grasps={row_name(key): grasp.kind for key, grasp in chain.grasps.items()},
        rows=[row.name for row in grasp_rows(chain, options.get("attached", ()))] if chain.beyond_serial else [],
        touches=[] if chain.touching is None else [*chain.touching.names],
        joints=chain.joint_names(),
        joint_kinds=[joint.kind for joint in chain.all_joints],
        work_terms=list(WORK_TERMS),
        units={name: row.text for name, row in RUN_ARRAYS.items()},
        duration=float(duration),
        step=float(step),
        options=options,
    )
