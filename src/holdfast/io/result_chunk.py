"""The chunks of a result folder: samples, and what happened at them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import msgspec

from holdfast.io.result_meta import RESULT, ResultMeta
from holdfast.io.stored_file import Damage, arrays_text, read_arrays
from holdfast.simulation.events import Occurrence
from holdfast.simulation.trajectory import TRUNK_FIELDS, Trajectory, array_names, stacked


def chunk_name(k: int) -> str:
    """Return the file name of chunk k."""
    return RESULT.chunk.format(k)


def chunk_text(samples: Sequence[Trajectory]) -> bytes:
    """Return samples as the bytes of a chunk."""
    chunk = stacked(samples)
    log = [{"sample": i, **asdict(line)} for i, one in enumerate(samples) for line in one.occurrences]
    return arrays_text({name: getattr(chunk, name) for name in array_names()}, "occurrences", log)


def read_chunk(folder: Path, k: int, meta: ResultMeta) -> Trajectory:
    """Return the samples of chunk k that belong to the run.

    Raises:
        Damage: samples are missing or damaged.
    """
    count = meta.chunks[k]
    arrays, log = read_arrays(folder, chunk_name(k), meta.files, "occurrences")
    if lacking := [name for name in array_names() if name not in (*arrays, *TRUNK_FIELDS)]:
        raise Damage(f"{chunk_name(k)} lacks {', '.join(lacking)}")
    for name, array in arrays.items():
        if array.shape[:1] < (count,):
            raise Damage(f"{chunk_name(k)} holds shape {array.shape} of '{name}', expected {count} samples")
    try:
        lines = msgspec.convert(log, list[dict[str, Any]])
        occurrences = msgspec.convert([line for line in lines if line["sample"] < count], tuple[Occurrence, ...])
    except (msgspec.ValidationError, KeyError, TypeError) as cause:
        raise Damage(f"{chunk_name(k)}: occurrences: {cause}") from cause
    ours: dict[str, Any] = {name: arrays[name][:count] for name in array_names() if name in arrays}
    return Trajectory(**ours, occurrences=occurrences)
