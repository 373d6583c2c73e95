"""A run made in Python as a result folder."""

from __future__ import annotations

import io
from os import PathLike
from pathlib import Path

import msgspec
import numpy as np

from holdfast.io.files import file_path
from holdfast.io.model_data import model_data
from holdfast.io.replaced_folder import replaced_folder
from holdfast.io.result_folder import CHUNK, ResultWriter, is_of_a_result, require_free, run_meta
from holdfast.io.result_meta import BASES, MODEL, ResultMeta
from holdfast.simulation.setting import RecordedBase, Setting, recorded_base
from holdfast.simulation.summary import summarise
from holdfast.simulation.trajectory import Occurrence, Trajectory, array_names

SCENE = """# A run made in Python by holdfast, without a scene. model.json contains its chain.
# Its controller and its initial state are not in this folder, so nobody can go on with it or begin it anew from here.
"""


def save_run(run: Trajectory, folder: str | PathLike[str], overwrite: bool = False) -> Path:
    """Write a run that knows its chain as a result folder, and return the folder.

    Args:
        run: what `simulate` returned.
        folder: where to; made if need be.
        overwrite: replace an earlier result there, which stays until the new one is whole.

    Raises:
        StateError: a run that does not know its chain.
        ResultError: the folder is in use or cannot be written.
    """
    place, setting = file_path(folder, "folder"), run.require_setting()
    require_free(place, overwrite, "overwrite=True")
    with replaced_folder(place, is_of_a_result) as new:
        writer = ResultWriter(new, meta_of(setting), SCENE, files=_own_files(run, setting))
        for k, one in enumerate(_singles(run)):
            writer.add(one)
            if (k + 1) % CHUNK == 0:
                writer.flush()
        writer.finish(summarise(setting.chain, run), stopped=run.stopped, occurrences=run.occurrences)
    return place


def meta_of(setting: Setting) -> ResultMeta:
    """Return the content of meta.json of a run made in Python, before its first sample."""
    return run_meta(setting.chain, setting.name, setting.duration, setting.step, **setting.options)


def _own_files(run: Trajectory, setting: Setting) -> dict[str, bytes]:
    """Return the chain, and how bases moved, as files."""
    found = {MODEL: msgspec.json.encode(model_data(setting.chain)) + b"\n"}
    if not setting.base_motion:
        return found
    arrays = {}
    for name, motion in setting.base_motion.items():
        base = motion if isinstance(motion, RecordedBase) else recorded_base(name, motion, run.t)
        arrays |= {f"{name}.{part}": getattr(base, part) for part in ("t", "R", "p", "twist", "acceleration")}
    file = io.BytesIO()
    np.savez(file, **arrays, bases=np.array(msgspec.json.encode(list(setting.base_motion)).decode()))
    return {**found, BASES: file.getvalue()}


def _singles(run: Trajectory) -> list[Trajectory]:
    """Return the samples one by one, each with what happened since the one before; the rest is what ended the run."""
    at: dict[int, list[Occurrence]] = {}
    for one in run.occurrences:
        at.setdefault(int(np.searchsorted(run.t, one.t)), []).append(one)
    return [
        Trajectory(**{name: getattr(run, name)[k] for name in array_names()}, occurrences=tuple(at.get(k, ())))
        for k in range(len(run))
    ]
