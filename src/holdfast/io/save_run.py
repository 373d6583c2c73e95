"""A run made in Python as a result folder."""

from __future__ import annotations

from collections.abc import Iterable
from os import PathLike
from pathlib import Path

import numpy as np

from holdfast.io.files import file_path, replaced_folder
from holdfast.io.model_data import model_text
from holdfast.io.result_folder import CHUNK, ResultWriter, run_meta
from holdfast.io.result_meta import BASES, MODEL, PLANNED, RESULT, WAS_INTERRUPTED, ResultMeta
from holdfast.io.store import arrays_text, require_free
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.checkpoint import Checkpoint
from holdfast.simulation.events import Occurrence
from holdfast.simulation.setting import RecordedBase, Setting, recorded_base
from holdfast.simulation.summary import Summary, summary_of_parts
from holdfast.simulation.trajectory import Trajectory, part_of
from holdfast.spatial.scalar import Array

ADVICE = "overwrite=True"
NO_SCENE = """# A run made in Python by holdfast, without a scene. model.json contains its chain.
# Its controller and its initial state are not in this folder, so nobody can go on with it or begin it anew from here.
"""


def save_run(run: Trajectory, folder: str | PathLike[str], overwrite: bool = False) -> Path:
    """Write a run that knows its chain as a result folder, and return the folder.

    Args:
        run: what `simulate` returned.
        folder: the folder; it is created if it does not exist.
        overwrite: replace an earlier result there, which is kept until the new one is complete.

    Raises:
        StateError: a run that does not know its chain.
        ResultError: the folder is in use or cannot be written.
    """
    place, setting = file_path(folder, "folder"), run.require_setting()
    require_free(place, RESULT, overwrite, ADVICE)
    with replaced_folder(place, RESULT.owns) as new:
        files = {MODEL: model_text(setting.chain)} | _bases(BASES, setting, run.t)
        writer = ResultWriter(new, meta_of(setting), NO_SCENE, files=files)
        for part in _parts(run):
            writer.add(part)
            if writer.waiting >= CHUNK:
                writer.flush()
        writer.finish(_summary(setting.chain, [run], run), stopped=run.stopped, occurrences=run.occurrences)
    return place


def meta_of(setting: Setting) -> ResultMeta:
    """Return the content of meta.json of a run made in Python, before its first sample."""
    return run_meta(setting.chain, setting.name, setting.duration, setting.step, **setting.options)


class AppendedRun:
    """A run that is written to a result folder while `simulate` makes it."""

    def __init__(self, folder: str | PathLike[str], setting: Setting, times: Array, overwrite: bool) -> None:
        """Check that the folder can be used.

        Args:
            folder: the folder; it is created with the first sample if it does not exist.
            setting: the setting of the run.
            times: the times at which steps are to end, where the motions of bases are recorded until the run has ended.
            overwrite: replace an earlier result there.

        Raises:
            ResultError: the folder is in use.
        """
        place = file_path(folder, "folder")
        files = {MODEL: model_text(setting.chain)} | _bases(PLANNED, setting, times)
        self._writer = ResultWriter(place, meta_of(setting), NO_SCENE, files=files, overwrite=overwrite, advice=ADVICE)

    def add(self, part: Trajectory, _: Checkpoint) -> None:
        """Take samples, and flush if a flush is due.

        Raises:
            ResultError: they cannot be written, or another process has written to the folder.
        """
        self._writer.add(part)
        self._writer.flush_if_due()

    def read(self, name: str) -> Array:
        """Return an array of all samples.

        Raises:
            ResultError: they cannot be written or read.
        """
        self._writer.flush()
        return np.concatenate([getattr(part, name) for part in self._writer.parts()])

    def finish(self, run: Trajectory) -> None:
        """Write the remaining samples, the summary, the motions of bases, and how the run ended.

        Raises:
            ResultError: they cannot be written, or another process has written to the folder.
        """
        self._writer.flush()
        setting = run.require_setting()
        moved = _bases(BASES, setting, run.t).get(BASES) if setting.base_motion else None
        summary = _summary(setting.chain, self._writer.parts(), run)
        self._writer.finish(summary, stopped=run.stopped, occurrences=run.occurrences, bases=moved)

    def interrupt(self) -> None:
        """Write the remaining samples of a run that an error or Ctrl-C ended.

        Raises:
            ResultError: they cannot be written, or another process has written to the folder.
        """
        self._writer.finish(None, stopped=WAS_INTERRUPTED)


def _summary(chain: ClosedChain, parts: Iterable[Trajectory], run: Trajectory) -> Summary | None:
    """Return the summary of a run, or None if some of the arrays for it were not recorded."""
    attached = () if run.setting is None else run.setting.options.get("attached", ())
    return summary_of_parts(chain, parts, run.stopped, run.occurrences, attached) if run.has_every_array else None


def _bases(name: str, setting: Setting, times: Array) -> dict[str, bytes]:
    """Return the file of this name with the motions of the bases; none if no base moved."""
    arrays = {}
    for base, motion in setting.base_motion.items():
        moved = motion if isinstance(motion, RecordedBase) else recorded_base(base, motion, times)
        arrays |= {f"{base}.{part}": getattr(moved, part) for part in ("t", "R", "p", "twist", "acceleration")}
    return {name: arrays_text(arrays, "bases", list(setting.base_motion))} if arrays else {}


def _parts(run: Trajectory) -> list[Trajectory]:
    """Return a run in parts of at most a chunk, each with what has happened at its last sample."""
    at: dict[int, list[Occurrence]] = {}
    for one in run.occurrences:
        at.setdefault(int(np.searchsorted(run.t, one.t)), []).append(one)
    ends = sorted({*(k + 1 for k in at if k < len(run)), *range(CHUNK, len(run), CHUNK), len(run)})
    return [part_of(run, slice(a, b), tuple(at.get(b - 1, ()))) for a, b in zip([0, *ends], ends, strict=False)]
