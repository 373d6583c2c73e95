"""Writing of a record of a rollout to a folder, which can be read at any moment while the rollout runs.

    record.npz           how it was made, the systems at the start and at the last flush, and the pieces that are there
    records_000000.npz   a piece: the time and the recorded arrays of some records
    model.json           the chain

A flush writes a piece under a new name, then moves a record.npz that names it over the old one: that move is the flush.
Pieces that record.npz does not name do not count.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from os import PathLike
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from holdfast.errors import ResultError
from holdfast.io.files import file_path, make_folder, remove, write_atomically
from holdfast.io.model_data import model_text
from holdfast.io.replaced_folder import replaced_folder, require_free
from holdfast.io.result_chunk import write_arrays
from holdfast.io.result_folder import PATIENCE
from holdfast.io.result_meta import MODEL
from holdfast.io.stored_arrays import StoredArrays, piece_name, plain
from holdfast.simulation.rollout.record import RolloutArguments, RolloutRecord
from holdfast.simulation.rollout.systems import RolloutSystems
from holdfast.spatial.scalar import Array

RECORD = "record.npz"
LARGEST_PIECE = 16 * 2**20  # bytes that wait until they are flushed


class RecordMeta(msgspec.Struct, forbid_unknown_fields=True):
    """How a record was made.

    Attributes:
        format, format_version: which layout this is.
        holdfast: the version that wrote it.
        step: h [s]; None of a record that was put together from arrays.
        every: steps from one record to the next.
        duration: requested duration [s].
        options: of `Rollout.step`.
        names: of the recorded arrays.
        pieces: number of records in each piece.
        complete: whether the rollout reached its end.
    """

    format: str = "holdfast-record"
    format_version: int = 1
    holdfast: str = ""
    step: float | None = None
    every: int = 1
    duration: float = 0.0
    options: dict[str, Any] = {}
    names: list[str] = []
    pieces: list[int] = []
    complete: bool = True


def meta_of_record(arguments: RolloutArguments | None) -> RecordMeta:
    """Return the content of the record's metadata before its first record; of arrays alone without `arguments`."""
    from holdfast import __version__

    if arguments is None:
        return RecordMeta(holdfast=__version__)
    options = {name: x if x is None or np.isfinite(x) else None for name, x in arguments.options.items()}
    return RecordMeta(
        holdfast=__version__,
        step=arguments.step,
        every=arguments.every,
        duration=arguments.duration,
        options=options,
        complete=False,
    )


class RecordWriter:
    """Writes the record of a rollout piece by piece; nothing is on disk before the first piece.

    Attributes:
        folder: the folder.
        started: whether a piece is on disk.
    """

    def __init__(self, folder: str | PathLike[str], arguments: RolloutArguments, overwrite: bool = False) -> None:
        """Check that the folder can be used.

        Raises:
            ResultError: it is in use.
        """
        self.folder = file_path(folder, "folder")
        require_free(self.folder, overwrite, "record", RECORD, "overwrite=True")
        self.started = False
        self._arguments, self._last, self._stopped = arguments, arguments.systems, np.zeros(0)
        self._meta, self._times = meta_of_record(arguments), list[Array]()
        self._flushed_at = -np.inf
        self._stamp: tuple[int, ...] = ()

    def is_due(self, waiting: Sequence[tuple[float, Mapping[str, Array]]]) -> bool:
        """Return whether waiting records are to be written: none is on disk yet, or they are many, or old."""
        size = len(waiting) * (8 + sum(x.nbytes for x in waiting[-1][1].values()))
        return size >= LARGEST_PIECE or time.monotonic() - self._flushed_at >= PATIENCE

    def append(
        self, t: Array, arrays: Mapping[str, Array], last: RolloutSystems, stopped: Array, complete: bool
    ) -> None:
        """Put records on disk; they are there to stay when this returns.

        Args:
            t: (records,) their times [s].
            arrays: their arrays by name, (records, systems, ...).
            last: the systems at the last of them.
            stopped: (systems,) time at which each stopped [s], infinite if it did not.
            complete: whether these are the last.

        Raises:
            ResultError: they cannot be written, or another process has written to the folder.
        """
        if self.started and self._stamp != _stamp(self.folder):
            raise ResultError(f"{self.folder}: another process has written to it; no more records are added")
        self._last, self._stopped = last, stopped
        if not self.started:
            self._begin()
        pieces = self._meta.pieces
        write_piece(self.folder, len(pieces), t, arrays)
        changes: dict[str, Any] = {"pieces": [*pieces, len(t)], "names": [*arrays]}
        self._commit(msgspec.structs.replace(self._meta, complete=complete, **changes))
        self._times.append(t)
        self._flushed_at = time.monotonic()

    def record(self) -> RolloutRecord:
        """Return the record, whose arrays are read from the folder when they are used."""
        t = np.concatenate(self._times)
        arrays = StoredArrays(self.folder, tuple(self._meta.pieces), tuple(self._meta.names))
        return RolloutRecord(t, arrays, self._last, self._stopped, self._arguments)

    def _begin(self) -> None:
        """Make the folder that of this record, without records yet; an earlier record there goes."""
        make_folder(self.folder)
        chain = model_text(self._last.chain)
        self._commit(self._meta)  # first, so that the folder is known as ours before anything else is in it
        remove(*self.folder.glob("records_*.npz"), *self.folder.glob("*.npz.part"))
        write_atomically(self.folder / MODEL, chain)
        self.started = True

    def _commit(self, meta: RecordMeta) -> None:
        write_head(self.folder, meta, self._arguments, self._last, self._stopped)
        self._meta, self._stamp = meta, _stamp(self.folder)


def save_record(record: RolloutRecord, folder: str | PathLike[str], overwrite: bool = False) -> Path:
    """Write a record as a folder, and return the folder; see `RolloutRecord.save`."""
    place = file_path(folder, "folder")
    require_free(place, overwrite, "record", RECORD, "overwrite=True")
    chain = model_text(record.systems.chain)
    with replaced_folder(place, is_of_a_record) as new:
        write_atomically(new / MODEL, chain)
        pieces = list[int]()
        for k, part in enumerate(record.parts()):
            write_piece(new, k, part.t, part.arrays)
            pieces.append(len(part.t))
        changes: dict[str, Any] = {"names": [*record.arrays], "pieces": pieces}
        meta = msgspec.structs.replace(meta_of_record(record.arguments), complete=not record.note, **changes)
        write_head(new, meta, record.arguments, record.systems, record.stopped)
    return place


def write_piece(folder: Path, k: int, t: Array, arrays: Mapping[str, Array]) -> None:
    """Write piece k, all or none.

    Raises:
        ResultError: it cannot be written.
    """
    write_arrays(folder / piece_name(k), {"t": t} | _under("record", arrays), "piece", k)


def write_head(
    folder: Path, meta: RecordMeta, arguments: RolloutArguments | None, last: RolloutSystems, stopped: Array
) -> None:
    """Write record.npz, all or none.

    Raises:
        ResultError: it cannot be written.
    """
    arrays = {"stopped": stopped} | _of(last, "last") | ({} if arguments is None else _of(arguments.systems, "first"))
    write_arrays(folder / RECORD, arrays, "meta", msgspec.to_builtins(meta))


def is_of_a_record(path: Path) -> bool:
    """Return whether a file's name is one of those in folders of records."""
    return path.name in (RECORD, MODEL) or fnmatchcase(path.name, "records_*.npz")


def _of(systems: RolloutSystems, name: str) -> dict[str, Array]:
    """Return all arrays of some systems, under the names that they have in a file."""
    own = {"begin": systems.begin, "step_length": systems.step_length}
    return _under(name, own) | _under(f"{name}_arrays", systems.arrays) | _under(f"{name}_inputs", systems.call_inputs)


def _under(name: str, arrays: Mapping[str, Array]) -> dict[str, Array]:
    return {f"{name}.{key}": plain(x) for key, x in arrays.items()}


def _stamp(folder: Path) -> tuple[int, ...]:
    """Return what tells one version of the folder's record.npz from another."""
    try:
        found = (folder / RECORD).stat()
    except OSError:
        return ()
    return found.st_ino, found.st_mtime_ns, found.st_size
