"""Making a result folder ready to go on from its checkpoint."""

from __future__ import annotations

from pathlib import Path

from msgspec.structs import replace

from holdfast.errors import ResultError
from holdfast.io.atomic import remove
from holdfast.io.result_arrays import Damage, read_arrays
from holdfast.io.result_chunk import cut_chunk, read_chunk, stray_chunks
from holdfast.io.result_meta import META, ResultMeta, differences, read_meta, write_meta
from holdfast.simulation.checkpoint import Checkpoint


def resumed(folder: Path, meta: ResultMeta) -> tuple[ResultMeta, Checkpoint] | None:
    """Return what the folder's meta.json says from now on, and the checkpoint to go on from.

    Samples after the checkpoint go, since the run makes them again. Reads every chunk, one
    at a time.

    Args:
        folder: where the run is.
        meta: of the run that is to go on.

    Returns:
        None where nothing was flushed yet.

    Raises:
        ResultError: the run has ended, is damaged, or is another one.
    """
    if not (folder / META).exists():
        return None
    found = read_meta(folder)
    if not found.samples:
        return None
    _require_open(folder, found, meta)
    if found.checkpoint is None:
        raise ResultError(f"{folder}: cannot go on: {found.no_checkpoint or 'it has no checkpoint'}; try --overwrite")
    try:
        arrays, texts = read_arrays(folder / found.checkpoint.file, "data")
        checkpoint = Checkpoint.from_data(arrays, texts["data"])
        kept = _up_to(found.checkpoint.samples, folder, found)
        write_meta(folder, kept)  # first: what goes now does not count any more
        cut_chunk(folder, len(kept.chunks) - 1, kept.chunks[-1])
    except Damage as damage:
        raise ResultError(f"{folder}: cannot go on: {damage}; try --overwrite") from damage
    _remove_the_rest(folder, kept)
    return kept, checkpoint


def _require_open(folder: Path, found: ResultMeta, meta: ResultMeta) -> None:
    """Refuse a run that is another one, or that has ended."""
    if differ := differences(found, meta):
        raise ResultError(
            f"{folder}: the run there cannot go on bit for bit, since these differ: {', '.join(differ)};"
            " try what it was begun with, or --overwrite"
        )
    if found.ended:
        how = found.stopped or f"the run is complete, {found.samples} samples up to t = {found.last_time:.6g} s"
        raise ResultError(f"{folder}: nothing to resume: {how}")


def _up_to(samples: int, folder: Path, meta: ResultMeta) -> ResultMeta:
    """Return the meta of the run's first samples.

    Raises:
        Damage: they are not all there.
    """
    counts: list[int] = []
    last_time = None
    for k, count in enumerate(meta.chunks):
        left = min(count, samples - sum(counts))
        if left > 0:
            last_time = float(read_chunk(folder, k, count).t[left - 1])
            counts.append(left)
    return replace(meta, samples=sum(counts), chunks=counts, last_time=last_time, stopped=None, occurrences=[])


def _remove_the_rest(folder: Path, meta: ResultMeta) -> None:
    """Take out of the folder what its meta.json does not name."""
    kept = meta.checkpoint.file if meta.checkpoint else None
    stray = [path for path in folder.glob("checkpoint_*.npz") if path.name != kept]
    remove(*stray_chunks(folder, len(meta.chunks)), *stray, *folder.glob("*.part"), folder / "summary.json")
