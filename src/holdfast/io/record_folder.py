"""Reading a record of a rollout from its folder, each array when it is first used; `record_writer` writes the files."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from holdfast.errors import ResultError, StateError
from holdfast.io.files import file_path
from holdfast.io.model_data import model_of
from holdfast.io.result_meta import MODEL
from holdfast.io.store import (
    CHANGED,
    Damage,
    FolderKind,
    Manifest,
    advising,
    read_arrays,
    read_manifest,
    stored,
    times_of_chunks,
)
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.fingerprint import fingerprint
from holdfast.questions.arrays import state_fields
from holdfast.simulation.rollout.record import RolloutArguments, RolloutRecord
from holdfast.simulation.rollout.rollout import Rollout
from holdfast.simulation.rollout.systems import RolloutStatus, RolloutSystems
from holdfast.spatial.frozen import read_only
from holdfast.spatial.scalar import Array

RECORD = FolderKind(
    name="record",
    manifest="record.json",
    versions=(2,),
    chunk="records_{:06d}.npz",
    data=("records_[0-9]*.npz", "systems_[0-9]*.npz", "record.npz"),
    others=(MODEL,),
    again="the same rollout with overwrite=True computes it again; numpy.load reads the files before",
)
ROLLOUT_STATUSES = list(RolloutStatus)
OLD = "record.npz"  # manifest and systems of holdfast 0.1


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


def load_record(folder: str | PathLike[str], rollout: Rollout | None = None) -> RolloutRecord:
    """Return the record in a folder that `RolloutRecord.save` or `Rollout.run` wrote, or is still writing.

    Looks at every piece of it, one at a time; arrays are read when they are first used. The `note` of a record that
    does not reach its end says how far it got.

    A control law is a program and is not in the folder. Only `record.trajectory(i)` needs it, which repeats the steps
    of a system; for this, pass the rollout that made the record.

    Args:
        folder: the folder.
        rollout: as it was compiled when the record was made.

    Raises:
        ResultError: no record is there, it is damaged, or the rollout is of another chain.
    """
    place = file_path(folder, "folder")
    checks.instance(rollout, (Rollout, type(None)), "load_record: rollout")
    meta = _manifest(place)
    while True:
        try:
            return _loaded(place, meta, rollout)
        except Damage as damage:
            now = _manifest(place)
            if now == meta:
                raise Damage(f"{place}: {damage}; {RECORD.again}") from damage
            meta = now  # the rollout went on


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
    return x if x.dtype != object else np.vectorize(ROLLOUT_STATUSES.index, otypes=[np.int64])(x)


def as_recorded(name: str, x: Array) -> Array:
    """Return an array that `plain` has written.

    Raises:
        Damage: it has no such statuses.
    """
    if name != "status":
        return x
    if x.dtype != np.int64 or not np.isin(x, np.arange(len(ROLLOUT_STATUSES))).all():
        raise Damage("status: no such numbers")
    return np.array(ROLLOUT_STATUSES)[x]


def _manifest(place: Path) -> RecordMeta:
    """Return the manifest of a record; of one by holdfast 0.1, from the file in which it was then.

    Raises:
        ResultError: there is none, it is damaged, or its format is another one.
    """
    if os.path.exists(place / RECORD.manifest) or not os.path.isfile(place / OLD):
        return read_manifest(place, RECORD, RecordMeta)
    files: dict[str, str | None] = {path.name: None for path in place.iterdir()}
    try:
        return msgspec.convert(read_arrays(place, OLD, files, "meta")[1] | {"files": files}, RecordMeta)
    except (Damage, TypeError, msgspec.ValidationError) as cause:
        raise Damage(f"{place}: {OLD} is damaged: {cause}; {RECORD.again}") from cause


def _loaded(place: Path, meta: RecordMeta, rollout: Rollout | None) -> RolloutRecord:
    """Return the record of a manifest; see `load_record`.

    Raises:
        Damage: a file is damaged.
        ResultError: there are no records yet, or the rollout is of another chain.
    """
    if not meta.pieces:
        raise ResultError(f"{place}: no records yet: the rollout has just begun, or ended before its first flush")
    arrays, _ = read_arrays(place, OLD if OLD in meta.files else meta.systems, meta.files, "meta")
    chain = model_of(stored(place, MODEL, meta.files), str(place / MODEL))
    systems, stopped = _systems(arrays, "last", chain), arrays["stopped"]
    times, damage = times_of_chunks(RECORD, meta.pieces, lambda k: read_piece(place, k, meta, len(systems)))
    if damage:
        lost = sum(meta.pieces[len(times) :])
        raise Damage(f"{damage}; {lost} of {sum(meta.pieces)} records are lost")
    t = np.concatenate(times)
    last = f"{t[-1]:.6g} s" if len(t) else "none"
    note = "" if meta.complete else f"incomplete, up to t = {last}: interrupted, or still running"
    arguments = None
    if rollout is not None and meta.step is not None:
        first = _systems(arrays, "first", chain)
        if fingerprint(rollout.chain) != fingerprint(chain):
            raise ResultError(f"{place}: expected the rollout that made it, got one of another chain")
        try:
            for each in (systems, first):
                rollout.kernel.require_own(each.arrays)
        except StateError as cause:
            raise ResultError(f"{place}: expected the rollout that made it: {cause}") from cause
        stops = {"least_margin": -np.inf}
        options = {name: stops.get(name) if x is None else x for name, x in meta.options.items()}
        arguments = RolloutArguments(rollout, first, meta.step, meta.every, options, meta.duration)
    return RolloutRecord(t, StoredArrays(place, meta), systems, stopped, arguments, note)


def parts_of_record(record: RolloutRecord) -> Iterator[RolloutRecord]:
    """Yield a record piece by piece; see `RolloutRecord.parts`."""
    if not isinstance(record.arrays, StoredArrays):
        yield record
        return
    for t, arrays in record.arrays.parts():
        yield replace(record, t=t, arrays=arrays, arguments=None)


def _below(arrays: dict[str, Array], name: str) -> dict[str, Array]:
    return {key.partition(".")[2]: x for key, x in arrays.items() if key.partition(".")[0] == name}


def _systems(arrays: dict[str, Array], name: str, chain: ClosedChain) -> RolloutSystems:
    """Return the systems that are under a name.

    Raises:
        Damage: they cannot be systems of the chain.
    """
    own, carried, inputs = (_below(arrays, key) for key in (name, f"{name}_arrays", f"{name}_inputs"))
    begin, length = own.get("begin", np.zeros(())), own.get("step_length", np.zeros(()))
    needed = {"count", "code", *state_fields(chain)}
    code = carried.get("code", np.zeros(0))
    if not (
        begin.ndim == 1
        and begin.shape == length.shape == arrays.get("stopped", np.zeros(0)).shape
        and needed <= carried.keys()
        and all(x.shape[:1] == begin.shape for x in carried.values())
        and all(x.ndim and len(x) in (1, len(begin)) for x in inputs.values())
        and all(x.dtype == np.float64 for x in (*carried.values(), begin, length))
        and carried["q"].shape[1:] == (chain.joint_count,)
        and np.isin(code, np.arange(len(ROLLOUT_STATUSES))).all()
    ):
        raise Damage("systems: arrays are missing, or have other shapes: damaged")
    systems = RolloutSystems(chain, carried, begin, length)
    systems.call_inputs = inputs
    return systems
