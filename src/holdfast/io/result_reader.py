"""Reading a result folder, however its run ended."""

from __future__ import annotations

import re
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from holdfast.errors import ResultError
from holdfast.io.result_folder import FORMAT, FORMAT_VERSION
from holdfast.simulation.trajectory import Trajectory, array_names


@dataclass(frozen=True, eq=False)
class Result:
    """A run read from disk.

    Attributes:
        folder: where it was.
        meta: what meta.json says (versions, joints, units, ...).
        scene_text: the scene's own text.
        trajectory: every sample that is on disk.
        complete: whether the run reached its end.
        note: what is missing, in words; empty for a complete run.
    """

    folder: Path
    meta: dict[str, Any]
    scene_text: str
    trajectory: Trajectory
    complete: bool
    note: str


def load_result(folder: str | Path) -> Result:
    """Return the run in a result folder, up to the last whole chunk.

    Raises:
        ResultError: no result is there, or none of it can be read.
    """
    folder = Path(folder)
    meta = _meta(folder)
    parts, damage = _chunks(folder)
    if not parts:
        raise ResultError(f"{folder}: expected at least one chunk of samples, {damage or 'found none'}")
    try:
        arrays = {name: np.concatenate([part[name] for part in parts]) for name in array_names()}
    except ValueError as cause:
        raise ResultError(f"{folder}: the chunks do not fit together: {cause}") from cause
    run = Trajectory(**arrays, stopped=meta.get("stopped"))
    complete = bool(meta.get("complete")) and not damage
    note = ""
    if not complete:
        reason = damage or run.stopped or "interrupted"
        note = f"incomplete, up to t = {run.t[-1]:.6g} s of {meta.get('duration')} s: {reason}"
    return Result(folder, meta, _read(folder / "scene.toml").decode("utf-8", "replace"), run, complete, note)


def _meta(folder: Path) -> dict[str, Any]:
    if not folder.is_dir():
        raise ResultError(f"{folder}: no such folder")
    try:
        meta = msgspec.json.decode(_read(folder / "meta.json"), type=dict)
    except msgspec.MsgspecError as cause:
        raise ResultError(f"{folder / 'meta.json'}: not valid JSON: {cause}") from cause
    if meta.get("format") != FORMAT or meta.get("format_version") != FORMAT_VERSION:
        raise ResultError(
            f"{folder / 'meta.json'}: expected format '{FORMAT}' version {FORMAT_VERSION}, got"
            f" {meta.get('format')!r} version {meta.get('format_version')!r}"
        )
    return meta


def _chunks(folder: Path) -> tuple[list[dict[str, Any]], str]:
    """Return the chunks before the first gap or damage, and what that was."""
    found = {int(m[1]): p for p in folder.glob("chunk_*.npz") if (m := re.fullmatch(r"chunk_(\d+)\.npz", p.name))}
    parts = []
    for k in range(max(found, default=-1) + 1):
        if k not in found:
            return parts, f"chunk_{k:04d}.npz is missing"
        try:
            # opened here: np.load leaves a file open when it is damaged
            with found[k].open("rb") as raw, np.load(raw, allow_pickle=False) as file:
                parts.append({name: file[name] for name in array_names()})
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return parts, f"{found[k].name} is damaged"
    return parts, ""


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as cause:
        raise ResultError(f"{path}: cannot be read: {cause.strerror or cause}; is this a result folder?") from cause
