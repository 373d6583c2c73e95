"""The .npz files of a result folder, whose damage is always detected, and its chunks of samples and log entries."""

from __future__ import annotations

import re
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from holdfast.io.files import write_atomically
from holdfast.simulation.trajectory import OF_TRUNK, Occurrence, Trajectory, array_names, stacked
from holdfast.spatial.scalar import Array

_UNREADABLE = (OSError, ValueError, KeyError, EOFError, RuntimeError, MemoryError, zipfile.BadZipFile, zlib.error)


class Damage(Exception):
    """A file is missing or damaged, or does not contain what meta.json says; the message names it."""


def write_arrays(path: Path, arrays: Mapping[str, Array], name: str, data: Any) -> None:
    """Write arrays by name, and plain data as an array of JSON text, either completely or not at all.

    Raises:
        ResultError: they cannot be written.
    """
    held = {**arrays, name: np.array(msgspec.json.encode(data).decode())}
    write_atomically(path, lambda file: np.savez(file, **held))  # pyright: ignore[reportArgumentType]


def read_arrays(path: Path, data_name: str) -> tuple[dict[str, Array], Any]:
    """Return the arrays of a file by name, and the plain data of the given name.

    Raises:
        Damage: the file is missing or damaged, or lacks the plain data.
    """
    if not path.is_file():
        raise Damage(f"{path.name} is {'not a file' if path.exists() else 'missing'}")
    try:
        # opened here, because np.load leaves a damaged file open
        with path.open("rb") as raw:
            with zipfile.ZipFile(raw) as archive:
                # our arrays are not compressed; a file that unpacks to more than its size was made to fill the memory
                if sum(part.file_size for part in archive.infolist()) > path.stat().st_size:
                    raise Damage(f"{path.name} is damaged: it unpacks to more than the size of the file")
                torn = archive.testzip()  # checked before any header is trusted
            if torn is not None:
                raise Damage(f"{path.name} is damaged at '{torn}'")
            raw.seek(0)
            with np.load(raw, allow_pickle=False) as file:
                held = {name: file[name] for name in file.files}
        data = msgspec.json.decode(held.pop(data_name).item())
        return held, data
    except _UNREADABLE as cause:
        raise Damage(f"{path.name} is damaged") from cause


def chunk_name(k: int) -> str:
    """Return the file name of chunk k."""
    return f"chunk_{k:04d}.npz"


def stray_chunks(folder: Path, count: int) -> list[Path]:
    """Return the chunks beyond the first `count`, whose writer died before meta.json named them."""
    found = [(path, re.fullmatch(r"chunk_(\d+)\.npz", path.name)) for path in sorted(folder.glob("chunk_*.npz"))]
    return [path for path, match in found if match and int(match[1]) >= count]


def write_chunk(folder: Path, k: int, samples: Sequence[Trajectory]) -> None:
    """Write samples as chunk k, either completely or not at all.

    Raises:
        ResultError: they cannot be written.
    """
    chunk = stacked(samples)
    log = [{"sample": i, **asdict(line)} for i, one in enumerate(samples) for line in one.occurrences]
    write_arrays(folder / chunk_name(k), {name: getattr(chunk, name) for name in array_names()}, "occurrences", log)


def read_chunk(folder: Path, k: int, count: int) -> Trajectory:
    """Return the first samples of chunk k.

    Args:
        folder: the result folder.
        k: number of the chunk.
        count: number of its samples that belong to the run.

    Raises:
        Damage: samples are missing.
    """
    arrays, log = _read(folder, k, count)
    if lacking := [name for name in array_names() if name not in (*arrays, *OF_TRUNK)]:
        raise Damage(f"{chunk_name(k)} lacks {', '.join(lacking)}")
    try:
        occurrences = msgspec.convert([line for line in log if line["sample"] < count], tuple[Occurrence, ...])
    except msgspec.ValidationError as cause:
        raise Damage(f"{chunk_name(k)}: occurrences: {cause}") from cause
    ours: dict[str, Any] = {name: arrays[name][:count] for name in array_names() if name in arrays}
    return Trajectory(**ours, occurrences=occurrences)


def cut_chunk(folder: Path, k: int, count: int) -> None:
    """Remove all but the first samples of chunk k, from all of its arrays.

    Raises:
        Damage: samples are missing.
        ResultError: the chunk cannot be written.
    """
    arrays, log = _read(folder, k, count)
    if max(map(len, arrays.values())) > count:
        first = {name: array[:count] for name, array in arrays.items()}
        kept = [line for line in log if line["sample"] < count]
        write_arrays(folder / chunk_name(k), first, "occurrences", kept)


def _read(folder: Path, k: int, count: int) -> tuple[dict[str, Array], list[dict[str, Any]]]:
    """Return the arrays of a chunk with at least the given number of samples, and its log.

    Raises:
        Damage: samples are missing.
    """
    arrays, log = read_arrays(folder / chunk_name(k), "occurrences")
    for name, array in arrays.items():
        if array.shape[:1] < (count,):
            raise Damage(f"{chunk_name(k)} holds shape {array.shape} of '{name}', expected {count} samples")
    try:
        return arrays, msgspec.convert(log, list[dict[str, Any]])
    except msgspec.ValidationError as cause:
        raise Damage(f"{chunk_name(k)}: occurrences: {cause}") from cause
