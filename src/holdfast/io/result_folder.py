"""Result folders: a run on disk, readable at any moment while it is being written.

    scene.toml       the scene's text
    meta.json        versions, names, units, how far the run got
    chunk_0000.npz   samples: the trajectory's arrays under their names
    summary.json     the summary table's numbers, once the run has ended

Every file is written beside its place and then moved there, so each is whole or absent.
"""

from __future__ import annotations

import platform
from dataclasses import asdict
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from holdfast.errors import ResultError
from holdfast.io.atomic import write_atomically
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.balance import WORK_TERMS
from holdfast.simulation.summary import Summary
from holdfast.simulation.trajectory import UNITS, Trajectory, array_names, stacked

FORMAT = "holdfast-result"
FORMAT_VERSION = 1
CHUNK = 100  # samples
OURS = ("scene.toml", "meta.json", "summary.json", "chunk_*.npz", "*.png", "*.part")


class ResultWriter:
    """Writes one run; nothing is on disk before there are samples.

    Attributes:
        folder: where to.
        samples: how many are on disk.
    """

    def __init__(self, folder: Path, meta: dict[str, Any], scene_text: str, *, overwrite: bool = False) -> None:
        """Check that the folder can be used.

        Args:
            folder: where to; made if need be.
            meta: what `run_meta` returns.
            scene_text: the scene file's own text.
            overwrite: replace an earlier result there.

        Raises:
            ResultError: the folder is in use.
        """
        require_free(folder, overwrite)
        self.folder = folder
        self.samples = 0
        self._chunks = 0
        self._waiting: list[Trajectory] = []
        self._scene_text = scene_text
        self._meta = dict(meta)

    def add(self, sample: Trajectory) -> None:
        """Take one sample; every 100 they go to disk.

        Raises:
            ResultError: they cannot be written.
        """
        self._waiting.append(sample)
        if len(self._waiting) >= CHUNK:
            self.flush()

    def flush(self) -> None:
        """Put what is waiting on disk.

        Raises:
            ResultError: it cannot be written.
        """
        if not self._waiting:
            return
        if not self._chunks:
            clear(self.folder)
            write_atomically(self.folder / "scene.toml", self._scene_text.encode("utf-8"))
        chunk = stacked(self._waiting)
        arrays: dict[str, Any] = {name: getattr(chunk, name) for name in array_names()}
        write_atomically(self.folder / f"chunk_{self._chunks:04d}.npz", lambda file: np.savez(file, **arrays))
        samples = self.samples + len(chunk)
        self._meta |= {"samples": samples, "last_time": float(chunk.t[-1])}
        write_atomically(self.folder / "meta.json", _json(self._meta))
        # only now, so that a flush that was broken off can be done again
        self.samples, self._chunks, self._waiting = samples, self._chunks + 1, []

    def finish(self, summary: Summary | None, *, stopped: str | None = None) -> None:
        """Put the rest on disk and say how the run ended.

        Args:
            summary: its numbers, if they were made.
            stopped: what ended it early; None for a complete run.

        Raises:
            ResultError: it cannot be written.
        """
        self.flush()
        if not self._chunks:
            return
        if summary is not None:
            write_atomically(self.folder / "summary.json", _json(asdict(summary)))
        self._meta |= {"complete": stopped is None, "stopped": stopped}
        write_atomically(self.folder / "meta.json", _json(self._meta))


def require_free(folder: Path, overwrite: bool) -> None:
    """Refuse a folder that holds anything, unless it is an earlier result to be replaced.

    Raises:
        ResultError: saying what is there.
    """
    try:
        names = sorted(path.name for path in folder.iterdir()) if folder.exists() else []
        meta = folder / "meta.json"
        earlier = meta.is_file() and FORMAT in meta.read_text(errors="replace")
    except OSError as cause:
        raise ResultError(f"{folder}: cannot be a result folder: {cause.strerror or cause}") from cause
    if not names:
        return
    if not earlier:
        raise ResultError(f"{folder}: expected a new or empty folder, or an earlier result; found '{names[0]}' in it")
    if not overwrite:
        raise ResultError(f"{folder}: holds an earlier result; try --overwrite, or another --out")


def clear(folder: Path) -> None:
    """Make the folder, and take an earlier result's files out of it.

    Raises:
        ResultError: it cannot be done.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for path in [path for pattern in OURS for path in folder.glob(pattern)]:
            path.unlink()
    except OSError as cause:
        raise ResultError(f"{folder}: cannot be written: {cause.strerror or cause}") from cause


def run_meta(chain: ClosedChain, name: str, duration: float, step: float) -> dict[str, Any]:
    """Return what meta.json says before the first sample.

    Args:
        chain: what is simulated.
        name: of the scene.
        duration: asked for [s].
        step: asked for [s].
    """
    from holdfast import __version__

    return {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "scene": name,
        "versions": {"holdfast": __version__, "numpy": np.__version__, "python": platform.python_version()},
        "arms": list(chain.names),
        "grasps": {name: grasp.kind for name, grasp in chain.grasps.items()},
        "joints": chain.joint_names(),
        "work_terms": list(WORK_TERMS),
        "units": UNITS,
        "duration": duration,
        "step": step,
        "samples": 0,
        "last_time": None,
        "complete": False,
        "stopped": None,
    }


def _json(data: Any) -> bytes:
    return msgspec.json.format(msgspec.json.encode(data), indent=2) + b"\n"
