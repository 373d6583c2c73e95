"""A run made in Python as a result folder."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

import numpy as np

from holdfast.io.files import file_path, replaced_folder
from holdfast.io.model_data import model_text
from holdfast.io.result_folder import CHUNK, ResultWriter, run_meta
from holdfast.io.result_meta import BASES, MODEL, PLANNED, RESULT, WAS_INTERRUPTED, ResultMeta
from holdfast.io.store import arrays_text, require_free
from holdfast.simulation.events import Occurrence
from holdfast.simulation.setting import RecordedBase, Setting, recorded_base
from holdfast.simulation.summary import summarise
from holdfast.simulation.trajectory import Trajectory, single
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
        for k, one in enumerate(_singles(run)):
            writer.add(one)
            if (k + 1) % CHUNK == 0:
                writer.flush()
        writer.finish(summarise(setting.chain, run), stopped=run.stopped, occurrences=run.occurrences)
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

    def add(self, sample: Trajectory) -> None:
        """Take a sample, and flush if a flush is due.

        Raises:
            ResultError: they cannot be written, or another process has written to the folder.
        """
        self._writer.add(sample)
        self._writer.flush_if_due()

    def finish(self, run: Trajectory) -> None:
        """Write the remaining samples, the motions of bases, and how the run ended.

        Raises:
            ResultError: they cannot be written, or another process has written to the folder.
        """
        setting = run.require_setting()
        summary, moved = summarise(setting.chain, run), _bases(BASES, setting, run.t)
        self._writer.finish(summary, stopped=run.stopped, occurrences=run.occurrences, bases=moved.get(BASES))

    def interrupt(self) -> None:
        """Write the remaining samples of a run that an error or Ctrl-C ended.

        Raises:
            ResultError: they cannot be written, or another process has written to the folder.
        """
        self._writer.finish(None, stopped=WAS_INTERRUPTED)


def _bases(name: str, setting: Setting, times: Array) -> dict[str, bytes]:
    """Return the file of this name with the motions of the bases; none if no base moved."""
    arrays = {}
    for base, motion in setting.base_motion.items():
        moved = motion if isinstance(motion, RecordedBase) else recorded_base(base, motion, times)
        arrays |= {f"{base}.{part}": getattr(moved, part) for part in ("t", "R", "p", "twist", "acceleration")}
    return {name: arrays_text(arrays, "bases", list(setting.base_motion))} if arrays else {}


def _singles(run: Trajectory) -> list[Trajectory]:
    """Return the samples one by one, each with the occurrences since the one before; later ones ended the run."""
    at: dict[int, list[Occurrence]] = {}
    for one in run.occurrences:
        at.setdefault(int(np.searchsorted(run.t, one.t)), []).append(one)
    return [single(run, k, tuple(at.get(k, ()))) for k in range(len(run))]
