"""Result folders: a run on disk, readable at any moment while it is written, and after any death of its writer.

    meta.json             which run it is, and which samples and which checkpoint are there
    scene.toml            the scene's text
    robot_*.urdf          the robots that it takes from files, xacro expanded
    chunk_0000.npz        samples: the trajectory's arrays under their names
    checkpoint_0000.npz   what the run goes on from, while it has not ended
    summary.json          the summary table's numbers, once it has
    model.json            of a run made in Python instead of a scene: its chain
    bases.npz             of such a run: how bases moved

A flush writes files under new names, then moves a meta.json that names them over the old one: that
move is the flush. Files that meta.json does not name do not count. docs/results.md is the format in full.
"""

from __future__ import annotations

import platform
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from fnmatch import fnmatchcase
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self

import numpy as np
from msgspec.structs import replace

from holdfast.errors import ResultError
from holdfast.io.files import make_folder, remove, write_atomically
from holdfast.io.replaced_folder import require_free
from holdfast.io.result_chunk import Damage, cut_chunk, read_arrays, read_chunk, stray_chunks, write_arrays, write_chunk
from holdfast.io.result_meta import (
    BASES,
    FORMAT,
    FORMAT_VERSION,
    META,
    MODEL,
    SCENE,
    CheckpointRecord,
    ResultMeta,
    differences,
    json_text,
    kept_files,
    read_bytes,
    read_meta,
    sha256,
)
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.fingerprint import fingerprint
from holdfast.robots.urdf.source import Source
from holdfast.simulation.balance import WORK_TERMS
from holdfast.simulation.checkpoint import Checkpoint
from holdfast.simulation.summary import Summary
from holdfast.simulation.trajectory import UNITS, Occurrence, Trajectory, array_names

CHUNK = 1000  # samples that wait until they are flushed
PATIENCE = 5.0  # seconds after which fewer are
RESULT_FILES = (
    SCENE,
    "robot_*.urdf",
    "summary.json",
    MODEL,
    BASES,
    "chunk_*.npz",
    "checkpoint_*.npz",
    "trajectory*.csv",
    "trajectory*.parquet",
    "*.png",
    "*.part",
)


class ResultWriter:
    """Writes one run; nothing is on disk before there is a sample.

    Attributes:
        folder: where to.
        start: what a resumed run goes on from; None for a new one.
    """

    def __init__(
        self,
        folder: Path,
        meta: ResultMeta,
        scene_text: str,
        *,
        robots: Mapping[str, Source] | None = None,
        overwrite: bool = False,
        files: Mapping[str, bytes] | None = None,
        advice: str = "--resume, --overwrite, or another --out",
    ) -> None:
        """Check that the folder can be used.

        Args:
            folder: where to; made if need be.
            meta: what `run_meta` returns.
            scene_text: the scene file's own text.
            robots: the URDF of each arm that is out of a file, by the arm's name.
            overwrite: replace an earlier result there.
            files: what else is in the folder, by name.
            advice: what to try where an earlier result is there.

        Raises:
            ResultError: the folder is in use.
        """
        require_free(folder, overwrite, "result", META, advice, FORMAT.encode())
        self.folder = folder
        self.start: Checkpoint | None = None
        self._scene = scene_text.encode("utf-8")
        records, kept = kept_files(robots or {})
        self._files = {**kept, **(files or {})}
        self._meta = replace(meta, scene_sha256=sha256(self._scene), robots=records)
        self._waiting: list[Trajectory] = []
        self._reported = 0  # occurrences
        self._marked: tuple[int, Checkpoint] | None = None
        self._started = False
        self._texts: tuple[bytes, ...] = ()  # of meta.json, as this writer left it or was about to
        self._flushed_at = -np.inf  # so that the first sample goes to disk at once

    @classmethod
    def resume(
        cls, folder: Path, meta: ResultMeta, scene_text: str, *, robots: Mapping[str, Source] | None = None
    ) -> Self:
        """Return a writer that adds to the run in a folder what comes after its checkpoint, `start`.

        Where a writer died before its first flush the run begins anew: `start` is None.

        Args:
            folder: where the run is.
            meta: what `run_meta` returns now.
            scene_text: the scene file's own text.
            robots: as for a new writer.

        Raises:
            ResultError: the run has ended, is damaged, is another one than this, or its
                controller's memory could not be written.
        """
        writer = cls(folder, meta, scene_text, robots=robots, overwrite=True)
        if (found := _resumed(folder, writer._meta)) is not None:
            writer._meta, writer.start = found
            writer._started, writer._texts = True, (json_text(writer._meta),)
            writer._flushed_at = time.monotonic()
        return writer

    @property
    def samples(self) -> int:
        """How many samples are on disk."""
        return self._meta.samples

    def add(self, sample: Trajectory) -> None:
        """Take one sample."""
        self._waiting.append(sample)
        self._reported += len(sample.occurrences)

    def mark(self, checkpoint: Checkpoint) -> None:
        """Take the checkpoint of the last sample, and flush if that is due."""
        self._marked = self.samples + len(self._waiting), checkpoint
        self.flush_if_due()

    def flush_if_due(self) -> None:
        """Flush if many samples wait, or for long, or none is on disk yet.

        Raises:
            ResultError: they cannot be written.
        """
        if len(self._waiting) >= CHUNK or time.monotonic() - self._flushed_at >= PATIENCE:
            self.flush()

    def flush(self) -> None:
        """Put what waits on disk; it is there to stay when this returns.

        A flush that was broken off can be done again. Costs six waits for the disk.

        Raises:
            ResultError: it cannot be written, or another process has written to the folder.
        """
        if not self._waiting:
            return
        if self._started:
            self._require_alone()
        else:
            self._begin()
        k, count = len(self._meta.chunks), len(self._waiting)
        write_chunk(self.folder, k, self._waiting)
        flushed = replace(
            self._with_checkpoint(k),
            samples=self.samples + count,
            chunks=[*self._meta.chunks, count],
            last_time=float(self._waiting[-1].t),
        )
        self._commit(flushed, waiting=[])
        self._flushed_at = time.monotonic()

    def finish(
        self, summary: Summary | None, *, stopped: str | None = None, occurrences: Sequence[Occurrence] = ()
    ) -> None:
        """Write the remaining samples and record how the run ended.

        Args:
            summary: the numbers of `summary.json`; None to write no such file.
            stopped: the reason why the run ended early; None for a complete run. Only a run that was "interrupted" can
                be resumed.
            occurrences: all occurrences since the run began or was resumed. Those after the last sample are stored as
                the ones that ended it.

        Raises:
            ResultError: A file cannot be written, or another process has written to the folder.
        """
        self.flush()
        if not self.samples:
            return
        self._require_alone()
        if summary is not None:
            write_atomically(self.folder / "summary.json", json_text(asdict(summary)))
        last = list(occurrences[self._reported :])
        ended = replace(self._meta, complete=stopped is None, stopped=stopped, occurrences=last)
        self._commit(replace(ended, checkpoint=None) if ended.ended else ended)

    def _begin(self) -> None:
        """Make the folder that of this run, without samples yet; an earlier result there goes."""
        make_folder(self.folder)
        self._write_meta(self._meta)  # first, so that the folder is known as ours before anything else is in it
        remove(*(path for pattern in RESULT_FILES for path in self.folder.glob(pattern)))
        for name, content in {SCENE: self._scene, **self._files}.items():
            write_atomically(self.folder / name, content)
        self._started = True

    def _require_alone(self) -> None:
        """Refuse to write where someone else did: two runs would mix."""
        if read_bytes(self.folder / META) not in self._texts:
            raise ResultError(
                f"{self.folder}: another process has written to it; no more samples of this run are added"
            )

    def _write_meta(self, meta: ResultMeta) -> None:
        """Put meta.json in place; whether that works or not, it is this writer's."""
        text = json_text(meta)
        self._texts = (*self._texts[-1:], text)
        write_atomically(self.folder / META, text)

    def _with_checkpoint(self, k: int) -> ResultMeta:
        """Return the meta that names the last checkpoint, after writing it."""
        if self._marked is None:
            return self._meta
        samples, checkpoint = self._marked
        try:
            arrays, data = checkpoint.to_data()
        except ResultError as cause:  # a memory that cannot be written is no reason to lose samples
            return replace(self._meta, checkpoint=None, no_checkpoint=str(cause))
        record = CheckpointRecord(f"checkpoint_{k:04d}.npz", samples)
        write_arrays(self.folder / record.file, arrays, "data", data)
        return replace(self._meta, checkpoint=record)

    def _commit(self, meta: ResultMeta, waiting: list[Trajectory] | None = None) -> None:
        """Put meta.json in place, then remove the checkpoint that it no longer names."""
        self._write_meta(meta)
        old = self._meta.checkpoint
        # only now, so that a flush that was broken off can be done again
        self._meta, self._waiting = meta, self._waiting if waiting is None else waiting
        if old is not None and (meta.checkpoint is None or meta.checkpoint.file != old.file):
            remove(self.folder / old.file)


def _resumed(folder: Path, meta: ResultMeta) -> tuple[ResultMeta, Checkpoint] | None:
    """Return the new content of the folder's meta.json, and the checkpoint to go on from.

    Samples after the checkpoint go, since the run makes them again. Reads every chunk, one
    at a time.

    Args:
        folder: where the run is.
        meta: of the run that is to go on.

    Returns:
        None where nothing was flushed yet.

    Raises:
        ResultError: the run has ended, is damaged, or is another one.
    """
    if not (folder / META).exists():
        return None
    found = read_meta(folder)
    if not found.samples:
        return None
    _require_open(folder, found, meta)
    if found.checkpoint is None:
        raise ResultError(
            f"{folder}: cannot be resumed: {found.no_checkpoint or 'it has no checkpoint'}; try --overwrite"
        )
    try:
        arrays, data = read_arrays(folder / found.checkpoint.file, "data")
        checkpoint = Checkpoint.from_data(arrays, data)
        kept = _up_to(found.checkpoint.samples, folder, found)
        write_atomically(folder / META, json_text(kept))  # first: what goes now does not count any more
        cut_chunk(folder, len(kept.chunks) - 1, kept.chunks[-1])
    except Damage as damage:
        raise ResultError(f"{folder}: cannot be resumed: {damage}; try --overwrite") from damage
    _remove_the_rest(folder, kept)
    return kept, checkpoint


def _require_open(folder: Path, found: ResultMeta, meta: ResultMeta) -> None:
    """Refuse a run that is another one, or that has ended."""
    if differ := differences(found, meta):
        raise ResultError(
            f"{folder}: the run there cannot be resumed identically, since these differ: {', '.join(differ)};"
            " try the original ones, or --overwrite"
        )
    if found.ended:
        how = found.stopped or f"the run is complete, {found.samples} samples up to t = {found.last_time:.6g} s"
        raise ResultError(f"{folder}: nothing to resume: {how}")


def _up_to(samples: int, folder: Path, meta: ResultMeta) -> ResultMeta:
    """Return the meta of the run's first samples.

    Raises:
        Damage: they are not all there.
    """
    counts: list[int] = []
    last_time = None
    for k, count in enumerate(meta.chunks):
        left = min(count, samples - sum(counts))
        if left > 0:
            last_time = float(read_chunk(folder, k, count).t[left - 1])
            counts.append(left)
    return replace(meta, samples=sum(counts), chunks=counts, last_time=last_time, stopped=None, occurrences=[])


def _remove_the_rest(folder: Path, meta: ResultMeta) -> None:
    """Take out of the folder what its meta.json does not name."""
    kept = meta.checkpoint.file if meta.checkpoint else None
    stray = [path for path in folder.glob("checkpoint_*.npz") if path.name != kept]
    remove(*stray_chunks(folder, len(meta.chunks)), *stray, *folder.glob("*.part"), folder / "summary.json")


def is_of_a_result(path: Path) -> bool:
    """Return whether a file's name is one of those in result folders."""
    return any(fnmatchcase(path.name, pattern) for pattern in (META, *RESULT_FILES))


def run_meta(
    chain: ClosedChain, name: str, duration: float, step: float, *, scene_folder: str = "", **options: Any
) -> ResultMeta:
    """Return the content of meta.json before the first sample.

    Args:
        chain: what is simulated.
        name: of the scene.
        duration: asked for [s].
        step: asked for [s].
        scene_folder: that names of robot files in the scene start from, if it has any.
        options: whatever else decides the numbers, plain data; a run goes on under the same ones only.
    """
    from holdfast import __version__

    packages = {"holdfast": __version__, "numpy": np.__version__, "llvmlite": version("llvmlite")}
    return ResultMeta(
        format=FORMAT,
        format_version=FORMAT_VERSION,
        scene=name,
        scene_folder=scene_folder,
        model_sha256=fingerprint(chain),
        versions=packages | {"python": platform.python_version(), "processor": platform.machine()},
        arms=list(chain.names),
        trunk=chain.trunk is not None,
        grasps={name: grasp.kind for name, grasp in chain.grasps.items()},
        joints=chain.joint_names(),
        joint_kinds=[joint.kind for joint in chain.all_joints],
        work_terms=list(WORK_TERMS),
        units={name: UNITS[name] for name in array_names()},
        duration=float(duration),
        step=float(step),
        options=options,
    )
