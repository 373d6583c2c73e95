"""Writing of a record of a rollout to a folder, which can be read at any moment while the rollout runs.

record.json          the manifest: how it was made, and the pieces that are there
records_000000.npz   a piece: the time and the recorded arrays of some records
systems_000001.npz   the systems at the start and after so many pieces
model.json           the chain
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from holdfast.io.files import file_path, replaced_folder
from holdfast.io.model_data import model_text
from holdfast.io.record_folder import RECORD, RecordMeta, StoredArrays, plain
from holdfast.io.result_folder import LONGEST_WAIT
from holdfast.io.result_meta import MODEL
from holdfast.io.store import StoreWriter, arrays_text, require_free
from holdfast.simulation.rollout.record import RolloutArguments, RolloutRecord
from holdfast.simulation.rollout.systems import RolloutSystems
from holdfast.spatial.scalar import Array

LARGEST_PIECE = 16 * 2**20  # bytes that wait until they are flushed


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
    """

    def __init__(
        self, folder: str | PathLike[str], arguments: RolloutArguments | None, overwrite: bool = False
    ) -> None:
        """Check that the folder can be used.

        Raises:
            ResultError: it is in use.
        """
        self.folder = file_path(folder, "folder")
        require_free(self.folder, RECORD, overwrite, "overwrite=True")
        self._store = StoreWriter(self.folder, RECORD)
        self._arguments, self._meta, self._times = arguments, meta_of_record(arguments), list[Array]()
        self._flushed_at = -np.inf

    @property
    def started(self) -> bool:
        """Whether anything is on disk."""
        return self._store.started

    def is_due(self, waiting: Sequence[tuple[float, Mapping[str, Array]]]) -> bool:
        """Return whether waiting records are to be written: none is on disk yet, or they are many, or old."""
        size = len(waiting) * (8 + sum(x.nbytes for x in waiting[-1][1].values()))
        return size >= LARGEST_PIECE or time.monotonic() - self._flushed_at >= LONGEST_WAIT

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
        self._store.begin(self._meta, {MODEL: model_text(last.chain)})
        old, pieces = self._meta, [*self._meta.pieces, len(t)]
        self._store.write(
            RECORD.chunk.format(len(old.pieces)),
            arrays_text({"t": t} | _under("record", arrays), "piece", len(old.pieces)),
        )
        meta = replace(old, pieces=pieces, names=[*arrays], complete=complete)
        first = {} if self._arguments is None else _of(self._arguments.systems, "first")
        self._store.write(meta.systems, arrays_text({"stopped": stopped} | _of(last, "last") | first, "meta", None))
        self._store.commit(meta, (old.systems,))
        self._meta, self._last, self._stopped = replace(meta, files=self._store.files), last, stopped
        self._times.append(t)
        self._flushed_at = time.monotonic()

    def record(self) -> RolloutRecord:
        """Return the record, whose arrays are read from the folder when they are used."""
        arrays = StoredArrays(self.folder, self._meta)
        return RolloutRecord(np.concatenate(self._times), arrays, self._last, self._stopped, self._arguments)


def save_record(record: RolloutRecord, folder: str | PathLike[str], overwrite: bool = False) -> Path:
    """Write a record as a folder, and return the folder; see `RolloutRecord.save`."""
    place = file_path(folder, "folder")
    require_free(place, RECORD, overwrite, "overwrite=True")
    with replaced_folder(place, RECORD.owns) as new:
        writer = RecordWriter(new, record.arguments)
        for part in record.parts():
            writer.append(part.t, part.arrays, record.systems, record.stopped, not record.note)
    return place


def _of(systems: RolloutSystems, name: str) -> dict[str, Array]:
    """Return all arrays of some systems, under the names that they have in a file."""
    own = {"begin": systems.begin, "step_length": systems.step_length}
    return _under(name, own) | _under(f"{name}_arrays", systems.arrays) | _under(f"{name}_inputs", systems.call_inputs)


def _under(name: str, arrays: Mapping[str, Array]) -> dict[str, Array]:
    return {f"{name}.{key}": plain(x) for key, x in arrays.items()}
