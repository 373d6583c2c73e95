"""A chunk of a result folder: the arrays of some samples, and what happened at them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import msgspec

from holdfast.io.result_arrays import Damage, read_arrays, write_arrays
from holdfast.simulation.trajectory import Occurrence, Trajectory, array_names, stacked
from holdfast.spatial.scalar import Array


def chunk_name(k: int) -> str:
    """Return the file name of chunk k."""
    return f"chunk_{k:04d}.npz"


def stray_chunks(folder: Path, count: int) -> list[Path]:
    """Return the chunks beyond the first `count`: their writer died before meta.json named them."""
    found = [(path, re.fullmatch(r"chunk_(\d+)\.npz", path.name)) for path in sorted(folder.glob("chunk_*.npz"))]
    return [path for path, match in found if match and int(match[1]) >= count]


def write_chunk(folder: Path, k: int, samples: Sequence[Trajectory]) -> None:
    """Write single samples as chunk k, all or none.

    Raises:
        ResultError: they cannot be written.
    """
    chunk = stacked(samples)
    log = [{"sample": i, **asdict(line)} for i, one in enumerate(samples) for line in one.occurrences]
    write_arrays(folder / chunk_name(k), {name: getattr(chunk, name) for name in array_names()}, occurrences=log)


def read_chunk(folder: Path, k: int, count: int) -> Trajectory:
    """Return the first samples of chunk k.

    Args:
        folder: the result folder.
        k: which chunk.
        count: how many of its samples belong to the run.

    Raises:
        Damage: they are not all there.
    """
    arrays, log = _read(folder, k, count)
    if lacking := [name for name in array_names() if name not in arrays]:
        raise Damage(f"{chunk_name(k)} lacks {', '.join(lacking)}")
    try:
        occurrences = msgspec.convert([line for line in log if line["sample"] < count], tuple[Occurrence, ...])
    except msgspec.ValidationError as cause:
        raise Damage(f"{chunk_name(k)}: occurrences: {cause}") from cause
    ours: dict[str, Any] = {name: arrays[name][:count] for name in array_names()}
    return Trajectory(**ours, occurrences=occurrences)


def cut_chunk(folder: Path, k: int, count: int) -> None:
    """Leave nothing but the first samples of chunk k, whatever arrays it has.

    Raises:
        Damage: they are not all there.
        ResultError: the chunk cannot be written.
    """
    arrays, log = _read(folder, k, count)
    if max(map(len, arrays.values())) > count:
        first = {name: array[:count] for name, array in arrays.items()}
        write_arrays(folder / chunk_name(k), first, occurrences=[line for line in log if line["sample"] < count])


def _read(folder: Path, k: int, count: int) -> tuple[dict[str, Array], list[dict[str, Any]]]:
    """Return the arrays of at least so many samples, and the log.

    Raises:
        Damage: they are not all there.
    """
    arrays, texts = read_arrays(folder / chunk_name(k), "occurrences")
    for name, array in arrays.items():
        if array.shape[:1] < (count,):
            raise Damage(f"{chunk_name(k)} holds shape {array.shape} of '{name}', expected {count} samples")
    try:
        return arrays, msgspec.convert(texts["occurrences"], list[dict[str, Any]])
    except msgspec.ValidationError as cause:
        raise Damage(f"{chunk_name(k)}: occurrences: {cause}") from cause
