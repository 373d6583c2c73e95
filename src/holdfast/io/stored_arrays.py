"""The recorded arrays of a rollout in a folder, each read when it is first used."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from holdfast.errors import ResultError
from holdfast.io.result_chunk import Damage, read_arrays
from holdfast.simulation.rollout.systems import RolloutStatus
from holdfast.spatial.frozen import read_only
from holdfast.spatial.scalar import Array

STATUSES = list(RolloutStatus)


class StoredArrays(Mapping[str, Array]):
    """The recorded arrays by name, (records, systems, ...); an array that has been read stays in memory.

    Attributes:
        folder: the folder of the record.
        pieces: number of records in each of its pieces.
        names: names of the arrays.
    """

    def __init__(self, folder: Path, pieces: tuple[int, ...], names: tuple[str, ...]) -> None:
        self.folder, self.pieces, self.names = folder, pieces, names
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
        for k, count in enumerate(self.pieces):
            try:
                yield read_piece(self.folder, k, count, self.names)
            except Damage as damage:
                raise ResultError(f"{self.folder}: changed while it was read: {damage}; try again") from damage


def piece_name(k: int) -> str:
    """Return the file name of piece k."""
    return f"records_{k:06d}.npz"


def read_piece(folder: Path, k: int, count: int, names: tuple[str, ...]) -> tuple[Array, dict[str, Array]]:
    """Return the times and the arrays of piece k.

    Raises:
        Damage: they are not there, or have another number of records.
    """
    arrays, number = read_arrays(folder / piece_name(k), "piece")
    found = {name: arrays[f"record.{name}"] for name in names if f"record.{name}" in arrays}
    t = arrays.get("t", np.zeros(0))
    if (
        number != k
        or len(found) < len(names)
        or t.shape != (count,)
        or any(x.shape[:1] != (count,) for x in found.values())
    ):
        raise Damage(f"{piece_name(k)} lacks arrays, or has them in other shapes")
    return t, {name: as_recorded(name, x) for name, x in found.items()}


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
        raise Damage("the statuses are none")
    return np.array(STATUSES)[x]
