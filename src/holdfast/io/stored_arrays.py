"""The recorded arrays of a rollout in a folder, each read when it is first used."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from holdfast.io.result_meta import MODEL
from holdfast.io.store import Kind, Manifest
from holdfast.io.stored_file import CHANGED, Damage, advising, read_arrays
from holdfast.simulation.rollout.systems import RolloutStatus
from holdfast.spatial.frozen import read_only
from holdfast.spatial.scalar import Array

RECORD = Kind(
    name="record",
    manifest="record.json",
    versions=(2,),
    chunk="records_{:06d}.npz",
    data=("records_[0-9]*.npz", "systems_[0-9]*.npz", "record.npz"),
    others=(MODEL,),
    again="the same rollout with overwrite=True computes it again; numpy.load reads the files before",
)
STATUSES = list(RolloutStatus)


class RecordMeta(Manifest, frozen=True, kw_only=True):
    """How a record was made.

    Attributes:
        holdfast: the version that wrote it.
        step: h [s]; None of a record that was put together from arrays.
        every: steps from one record to the next.
        duration: requested duration [s].
        options: of `Rollout.step`.
        names: of the recorded arrays.
        pieces: number of records in each piece.
        complete: whether the rollout reached its end.
    """

    format: str = RECORD.format
    format_version: int = RECORD.versions[0]
    holdfast: str = ""
    step: float | None = None
    every: int = 1
    duration: float = 0.0
    options: dict[str, Any] = msgspec.field(default_factory=dict)
    names: list[str] = msgspec.field(default_factory=list)
    pieces: list[int] = msgspec.field(default_factory=list)
    complete: bool = True

    @property
    def systems(self) -> str:
        """Name of the file with the systems at the start and at the last piece."""
        return f"systems_{len(self.pieces):06d}.npz"


class StoredArrays(Mapping[str, Array]):
    """The recorded arrays by name, (records, systems, ...); an array that has been read stays in memory.

    Attributes:
        folder: the folder of the record.
        meta: its manifest.
        names: names of the arrays.
    """

    def __init__(self, folder: Path, meta: RecordMeta) -> None:
        self.folder, self.meta, self.names = folder, meta, tuple(meta.names)
        self._read: dict[str, Array] = {}

    def __getitem__(self, name: str) -> Array:
        """Return an array, all pieces of it.

        Raises:
            ResultError: the folder has changed since it was opened.
        """
        if name not in self.names:
            raise KeyError(name)
        if name not in self._read:
            self._read[name] = read_only(np.concatenate([arrays[name] for _, arrays in self.parts()]))
        return self._read[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __len__(self) -> int:
        return len(self.names)

    def parts(self) -> Iterator[tuple[Array, dict[str, Array]]]:
        """Yield times and arrays piece by piece, of which one at a time is in memory.

        Raises:
            ResultError: the folder has changed since it was opened.
        """
        for k in range(len(self.meta.pieces)):
            with advising(self.folder, CHANGED):
                piece = read_piece(self.folder, k, self.meta)
            yield piece


def read_piece(folder: Path, k: int, meta: RecordMeta, systems: int | None = None) -> tuple[Array, dict[str, Array]]:
    """Return the times and the arrays of piece k, of so many systems.

    Raises:
        Damage: they are not there, or have another number of records.
    """
    name, count = RECORD.chunk.format(k), meta.pieces[k]
    arrays, number = read_arrays(folder, name, meta.files, "piece")
    found = {title: arrays[f"record.{title}"] for title in meta.names if f"record.{title}" in arrays}
    t = arrays.get("t", np.zeros(0))
    if (
        number != k
        or len(found) < len(meta.names)
        or t.shape != (count,)
        or any(x.shape[:1] != (count,) or systems not in (None, *x.shape[1:2]) for x in found.values())
    ):
        raise Damage(f"{name} is damaged: it lacks arrays, or has them in other shapes")
    return t, {title: as_recorded(title, x) for title, x in found.items()}


def plain(x: Array) -> Array:
    """Return an array of numbers; of statuses their numbers, since reading objects from a file would run code."""
    return x if x.dtype != object else np.vectorize(STATUSES.index, otypes=[np.int64])(x)


def as_recorded(name: str, x: Array) -> Array:
    """Return an array that `plain` has written.

    Raises:
        Damage: it has no such statuses.
    """
    if name != "status":
        return x
    if x.dtype != np.int64 or not np.isin(x, np.arange(len(STATUSES))).all():
        raise Damage("status: no such numbers")
    return np.array(STATUSES)[x]
