"""Reading a result folder, however its run ended."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike
from pathlib import Path

from holdfast.errors import ResultError, StateError
from holdfast.io.files import file_path
from holdfast.io.model_data import model_of
from holdfast.io.result_meta import (
    BASES,
    MODEL,
    PLANNED,
    RESULT,
    SCENE,
    SUMMARY,
    ResultMeta,
    kept_robots,
    read_chunk,
    read_meta,
)
from holdfast.io.store import CHANGED, Damage, advising, read_arrays, stored, times_of_chunks
from holdfast.model.fingerprint import fingerprint
from holdfast.simulation.run_outputs import RunOutputs
from holdfast.simulation.setting import RecordedBase, Setting
from holdfast.simulation.trajectory import EMPTY_FIELDS, Trajectory, array_names, joined
from holdfast.spatial.scalar import Array


@dataclass(frozen=True, eq=False)
class Result(RunOutputs):
    """A run on disk; what `simulate` returns has the same methods.

    Attributes:
        folder: where it is.
        meta: the content of meta.json: versions, joints, units, ...
        scene_text: the scene's own text; empty if it is damaged.
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
        """Number of samples that can be read."""
        return sum(self.chunks)

    @cached_property
    def trajectory(self) -> Trajectory:
        """All samples on disk, read at the first access.

        Raises:
            ResultError: the folder changed since `load_result`.
        """
        run, setting = joined(list(self.parts()), self.meta.stopped), None
        with suppress(Damage):  # which `note` names; the samples can be read nevertheless
            setting = self.setting if self.keeps_model else None
        return replace(run, setting=setting)

    @property
    def keeps_model(self) -> bool:
        """Whether the folder contains the chain, as for a run made in Python; otherwise it contains a scene."""
        return MODEL in self.meta.files

    @cached_property
    def setting(self) -> Setting:
        """Chain, law and options of the run; a scene is rebuilt from the stored robot files.

        Raises:
            ResultError: the folder changed, or is of another chain.
            SceneError, ClosureError: the scene cannot be read any more.
        """
        return setting_of(self.folder, self.meta)

    def whole_run(self) -> Trajectory:
        """Return all samples with the setting of the run.

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
        for k in range(len(self.chunks)):
            with advising(self.folder, CHANGED):
                part = read_chunk(self.folder, k, self.meta)
            at_end = tuple(self.meta.occurrences) if k == last else ()
            yield replace(part, stopped=self.meta.stopped, occurrences=part.occurrences + at_end)


def load_result(folder: str | PathLike[str]) -> Result:
    """Return the run in a result folder, up to the last flush before the first damage.

    Every chunk is checked, one at a time; samples are read at the first access.

    Args:
        folder: a folder that `holdfast simulate`, `run.save` or a `ResultWriter` wrote.

    Raises:
        ResultError: there is no result, nothing of it can be read, or it lacks arrays.
    """
    folder = file_path(folder, "folder")
    meta = read_meta(folder)
    if not meta.samples:
        raise ResultError(f"{folder}: no samples yet: the run ended before its first flush, or has just begun")
    ours = array_names()
    if missing := [name for name in ours if name not in (*meta.units, *EMPTY_FIELDS)]:
        raise ResultError(
            f"{folder}: written by holdfast {meta.versions.get('holdfast')}, which had no {', '.join(missing)};"
            " try that version, or numpy.load on the chunks"
        )
    times, damage = times_of_chunks(RESULT, meta.chunks, lambda k: _named(read_chunk(folder, k, meta)))
    if not times:
        raise ResultError(f"{folder}: expected at least one whole chunk of samples, but {damage}; {RESULT.again}")
    complete, notes = meta.complete and not damage, list[str]()
    if not complete:
        reason = damage or meta.stopped or "interrupted, or still running"
        notes.append(f"incomplete, up to t = {times[-1][-1]:.6g} s of {meta.duration} s: {reason}")
    if unknown := [name for name in meta.units if name not in ours]:
        notes.append(f"written by holdfast {meta.versions.get('holdfast')}, its {', '.join(unknown)} are ignored")
    files, texts = {**meta.files, SCENE: meta.scene_sha256}, {SCENE: b""}
    # not checkpoint and plan, which a run that is going on may just have removed
    for name in (SCENE, MODEL, BASES, SUMMARY, *dict.fromkeys(robot.file for robot in meta.robots.values())):
        try:
            texts[name] = stored(folder, name, files) if name in files else b""
        except Damage as found:
            notes.append(damage := str(found))
    notes += [RESULT.again] if damage else []
    notes += [f"{name} is not part of the run" for name in RESULT.strays(folder, len(meta.chunks))]
    scene, whole = texts[SCENE].decode("utf-8", "replace"), tuple(meta.chunks[: len(times)])
    return Result(folder, meta, scene, whole, complete, "; ".join(notes))


def _named(part: Trajectory) -> tuple[Array, dict[str, Array]]:
    """Return times and arrays of a chunk."""
    return part.t, {name: getattr(part, name) for name in part.recorded}


def setting_of(folder: Path, meta: ResultMeta, trust_xacro: bool = False) -> Setting:
    """Return the setting of a run, from the chain in its folder or from its scene, which is read again.

    Folders written by holdfast 0.1 contain no robots, which are then loaded from their original files.

    Args:
        folder: the result folder.
        meta: the content of its meta.json.
        trust_xacro: expand xacro files of a folder that contains no robots.

    Raises:
        ResultError: the model, or the motion of the bases, cannot be read, or has other joints.
        SceneError, ClosureError: the scene, or a robot file that it names, cannot be read any more.
    """
    keeps_model = MODEL in meta.files
    source = folder / (MODEL if keeps_model else SCENE)
    with advising(folder, f"{RESULT.again}; the samples can be read without it"):
        controller = None
        if keeps_model:
            chain = model_of(stored(folder, MODEL, meta.files), str(source))
            moved = _bases(folder, meta)
        else:
            from holdfast.scenario.build import load_scene

            stored(folder, SCENE, {SCENE: meta.scene_sha256})
            robots = kept_robots(folder, meta.robots)
            scenario = load_scene(source, meta.scene_folder or None, trust_xacro=trust_xacro, robots=robots)
            chain, moved = scenario.chain, scenario.options.get("base_motion", {})
            controller = scenario.controller
    if (joints := chain.joint_names()) != meta.joints:
        raise ResultError(
            f"{source}: not the {'chain' if keeps_model else 'scene'} of this run: expected the joints"
            f" {', '.join(meta.joints)}, got {', '.join(joints)}"
        )
    if keeps_model and fingerprint(chain) != meta.model_sha256:
        raise ResultError(f"{source}: expected the model that was simulated, got another one")
    return Setting(chain, moved, meta.scene, meta.duration, meta.step, meta.options, controller)


def _bases(folder: Path, meta: ResultMeta) -> dict[str, RecordedBase]:
    """Return the motions of the bases that moved, by name."""
    name = BASES if BASES in meta.files else PLANNED
    if name not in meta.files:
        return {}
    arrays, names = read_arrays(folder, name, meta.files, "bases")
    parts = ("t", "R", "p", "twist", "acceleration")
    try:
        return {base: RecordedBase(*(arrays[f"{base}.{part}"] for part in parts)) for base in names}
    except (KeyError, TypeError, StateError) as cause:
        raise Damage(f"{name} is damaged: {cause}") from cause
