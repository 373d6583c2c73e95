"""Reading a result folder, however its run ended."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike
from pathlib import Path

import numpy as np

from holdfast.errors import ResultError
from holdfast.io.files import file_path
from holdfast.io.result_chunk import Damage, chunk_name, read_chunk, stray_chunks
from holdfast.io.result_meta import MODEL, ResultMeta, read_bytes, read_meta, sha256
from holdfast.io.run_setting import setting_of
from holdfast.simulation.run_outputs import RunOutputs
from holdfast.simulation.setting import Setting
from holdfast.simulation.trajectory import OF_TRUNK, Trajectory, array_names


@dataclass(frozen=True, eq=False)
class Result(RunOutputs):
    """A run on disk; what `simulate` returns has the same methods.

    Attributes:
        folder: where it is.
        meta: the content of meta.json: versions, joints, units, ...
        scene_text: the scene's own text.
        chunks: how many samples of each chunk are whole and belong to the run.
        complete: whether the run reached its end, and all of it is there.
        note: what is missing or odd, in words; empty for a complete run.
    """

    folder: Path
    meta: ResultMeta
    scene_text: str
    chunks: tuple[int, ...]
    complete: bool
    note: str

    @property
    def samples(self) -> int:
        """How many samples can be read."""
        return sum(self.chunks)

    @cached_property
    def trajectory(self) -> Trajectory:
        """Every sample that is on disk; read when first asked for.

        Raises:
            ResultError: the folder changed since `load_result`.
        """
        parts = list(self.parts())
        arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in array_names()}
        occurrences = tuple(one for part in parts for one in part.occurrences)
        setting = self.setting if self.keeps_model else None
        return Trajectory(**arrays, stopped=self.meta.stopped, occurrences=occurrences, setting=setting)

    @property
    def keeps_model(self) -> bool:
        """Whether the folder keeps its chain, as that of a run made in Python does; else it has a scene."""
        return (self.folder / MODEL).exists()

    @cached_property
    def setting(self) -> Setting:
        """What it is a run of; a scene is read anew, of the robots that the folder keeps.

        Raises:
            ResultError: the folder changed, or is of another chain.
            SceneError, ClosureError: the scene cannot be read any more.
        """
        return setting_of(self.folder, self.meta)

    def whole_run(self) -> Trajectory:
        """Return every sample, with what it is a run of.

        Raises:
            HoldfastError: as for `trajectory` and `setting`.
        """
        return replace(self.trajectory, setting=self.setting)

    def __repr__(self) -> str:
        """Return folder, length and state, on one line."""
        state = "complete" if self.complete else self.note
        return f"<Result '{self.meta.scene}' in {self.folder}: {self.samples} samples, {state}>"

    def parts(self) -> Iterator[Trajectory]:
        """Yield the run chunk by chunk, from its first sample on, one chunk in memory at a time.

        Raises:
            ResultError: the folder changed since `load_result`.
        """
        last = len(self.meta.chunks) - 1
        for k, count in enumerate(self.chunks):
            try:
                part = read_chunk(self.folder, k, count)
            except Damage as damage:
                raise ResultError(f"{self.folder}: changed while it was read: {damage}; try again") from damage
            at_end = tuple(self.meta.occurrences) if k == last else ()
            yield replace(part, stopped=self.meta.stopped, occurrences=part.occurrences + at_end)


def load_result(folder: str | PathLike[str]) -> Result:
    """Return the run in a result folder, up to the last flush before the first damage.

    Looks at every chunk, one at a time; the samples are read when they are asked for.

    Args:
        folder: where `holdfast simulate` or a `ResultWriter` wrote it.

    Raises:
        ResultError: no result is there, or none of it can be read, or it lacks arrays.
    """
    folder = file_path(folder, "folder")
    meta = read_meta(folder)
    if not meta.samples:
        raise ResultError(f"{folder}: no samples yet: the run ended before its first flush, or has just begun")
    ours = array_names()
    if missing := [name for name in ours if name not in (*meta.units, *OF_TRUNK)]:
        raise ResultError(
            f"{folder}: written by holdfast {meta.versions.get('holdfast')}, which had no {', '.join(missing)};"
            " try that version, or numpy.load on the chunks"
        )
    chunks, last_time, damage = _whole_chunks(folder, meta)
    if not chunks:
        raise ResultError(f"{folder}: expected at least one whole chunk of samples, but {damage}")
    complete = meta.complete and not damage
    notes = []
    if not complete:
        reason = damage or meta.stopped or "interrupted, or still running"
        notes.append(f"incomplete, up to t = {last_time:.6g} s of {meta.duration} s: {reason}")
    if unknown := [name for name in meta.units if name not in ours]:
        notes.append(f"written by holdfast {meta.versions.get('holdfast')}, its {', '.join(unknown)} are ignored")
    scene = read_bytes(folder / "scene.toml")
    if sha256(scene) != meta.scene_sha256:
        notes.append("scene.toml is not the text of the simulated scene")
    notes += [f"{path.name} is not part of the run" for path in stray_chunks(folder, len(meta.chunks))]
    return Result(folder, meta, scene.decode("utf-8", "replace"), tuple(chunks), complete, "; ".join(notes))


def _whole_chunks(folder: Path, meta: ResultMeta) -> tuple[list[int], float, str]:
    """Return samples of the chunks before the first damage, the last one's time, and that damage."""
    counts: list[int] = []
    last_time, shapes = np.nan, None
    for k, count in enumerate(meta.chunks):
        try:
            part = read_chunk(folder, k, count)
            here = [getattr(part, name).shape[1:] for name in array_names()]
            if here != (shapes or here):
                raise Damage(f"{chunk_name(k)} does not continue the previous chunks")
        except Damage as damage:
            return counts, last_time, str(damage)
        counts.append(count)
        last_time, shapes = float(part.t[-1]), here
    return counts, last_time, ""
