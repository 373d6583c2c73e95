"""The folder of a record of a rollout, which can be read at any moment while the rollout runs and writes it.

record.json          the manifest: how it was made, and the pieces that are there
records_000000.npz   a piece: the time and the recorded arrays of some records
systems_000001.npz   the systems at the start and after so many pieces
model.json           the chain

Arrays are read when they are first used.
"""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from holdfast.errors import ResultError, StateError
from holdfast.io import store
from holdfast.io.files import file_path, replaced_folder
from holdfast.io.model_data import model_of, model_text
from holdfast.io.result_folder import LONGEST_WAIT
from holdfast.io.result_meta import MODEL
from holdfast.io.store import Damage, stored
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.fingerprint import fingerprint
from holdfast.questions.arrays import state_fields
from holdfast.simulation.rollout.record import RolloutArguments, RolloutRecord
from holdfast.simulation.rollout.rollout import Rollout
from holdfast.simulation.rollout.systems import RolloutStatus, RolloutSystems
from holdfast.spatial.frozen import read_only
from holdfast.spatial.scalar import Array

RECORD = store.FolderKind(
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
LARGEST_PIECE = 16 * 2**20  # bytes that wait until they are flushed


class RecordMeta(store.Manifest, frozen=True, kw_only=True):
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
            with store.advising(self.folder, store.CHANGED):
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


def _manifest(place: Path) -> RecordMeta:
    """Return the manifest of a record; of one by holdfast 0.1, from the file in which it was then.

    Raises:
        ResultError: there is none, it is damaged, or its format is another one.
    """
    if os.path.exists(place / RECORD.manifest) or not os.path.isfile(place / OLD):
        return store.read_manifest(place, RECORD, RecordMeta)
    files: dict[str, str | None] = {path.name: None for path in place.iterdir()}
    try:
        return msgspec.convert(store.read_arrays(place, OLD, files, "meta")[1] | {"files": files}, RecordMeta)
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
    arrays, _ = store.read_arrays(place, OLD if OLD in meta.files else meta.systems, meta.files, "meta")
    chain = model_of(stored(place, MODEL, meta.files), str(place / MODEL))
    systems, stopped = _systems(arrays, "last", chain), arrays["stopped"]
    times, damage = store.times_of_chunks(RECORD, meta.pieces, lambda k: read_piece(place, k, meta, len(systems)))
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
                if OLD in meta.files and "resolution" in rollout.kernel.carried:
                    each.arrays.setdefault("resolution", np.zeros((len(each), 4)))
                rollout.kernel.require_own(each.arrays)
        except StateError as cause:
            raise ResultError(f"{place}: expected the rollout that made it: {cause}") from cause
        stops = {"least_margin": -np.inf}
        options = {name: stops.get(name) if x is None else x for name, x in meta.options.items()}
        arguments = RolloutArguments(rollout, first, meta.step, meta.every, options, meta.duration)
    return RolloutRecord(t, StoredArrays(place, meta), systems, stopped, arguments, note)


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
        and carried["q"].shape[1:] == (chain.position_count,)
        and np.isin(code, np.arange(len(ROLLOUT_STATUSES))).all()
    ):
        raise Damage("systems: arrays are missing, or have other shapes: damaged")
    systems = RolloutSystems(chain, carried, begin, length)
    systems.call_inputs = inputs
    return systems


def parts_of_record(record: RolloutRecord) -> Iterator[RolloutRecord]:
    """Yield a record piece by piece; see `RolloutRecord.parts`."""
    if not isinstance(record.arrays, StoredArrays):
        yield record
        return
    for t, arrays in record.arrays.parts():
        yield replace(record, t=t, arrays=arrays, arguments=None)


def read_piece(folder: Path, k: int, meta: RecordMeta, systems: int | None = None) -> tuple[Array, dict[str, Array]]:
    """Return the times and the arrays of piece k, of so many systems.

    Raises:
        Damage: they are not there, or have another number of records.
    """
    name, count = RECORD.chunk.format(k), meta.pieces[k]
    arrays, number = store.read_arrays(folder, name, meta.files, "piece")
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


def plain(x: Array) -> Array:
    """Return an array of numbers; of statuses their numbers, since reading objects from a file would run code."""
    return x if x.dtype != object else np.vectorize(ROLLOUT_STATUSES.index, otypes=[np.int64])(x)


def save_record(record: RolloutRecord, folder: str | PathLike[str], overwrite: bool = False) -> Path:
    """Write a record as a folder, and return the folder; see `RolloutRecord.save`."""
    place = file_path(folder, "folder")
    store.require_free(place, RECORD, overwrite, "overwrite=True")
    with replaced_folder(place, RECORD.owns) as new:
        writer = RecordWriter(new, record.arguments)
        for part in record.parts():
            writer.append(part.t, part.arrays, record.systems, record.stopped, not record.note)
    return place


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
        store.require_free(self.folder, RECORD, overwrite, "overwrite=True")
        self._store = store.StoreWriter(self.folder, RECORD)
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
            store.arrays_text({"t": t} | _under("record", arrays), "piece", len(old.pieces)),
        )
        meta = msgspec.structs.replace(old, pieces=pieces, names=[*arrays], complete=complete)
        first = {} if self._arguments is None else _of(self._arguments.systems, "first")
        self._store.write(
            meta.systems, store.arrays_text({"stopped": stopped} | _of(last, "last") | first, "meta", None)
        )
        self._store.commit(meta, (old.systems,))
        self._meta, self._last, self._stopped = msgspec.structs.replace(meta, files=self._store.files), last, stopped
        self._times.append(t)
        self._flushed_at = time.monotonic()

    def record(self) -> RolloutRecord:
        """Return the record, whose arrays are read from the folder when they are used."""
        arrays = StoredArrays(self.folder, self._meta)
        return RolloutRecord(np.concatenate(self._times), arrays, self._last, self._stopped, self._arguments)


def _of(systems: RolloutSystems, name: str) -> dict[str, Array]:
    """Return all arrays of some systems, under the names that they have in a file."""
    own = {"begin": systems.begin, "step_length": systems.step_length}
    return _under(name, own) | _under(f"{name}_arrays", systems.arrays) | _under(f"{name}_inputs", systems.call_inputs)


def _under(name: str, arrays: Mapping[str, Array]) -> dict[str, Array]:
    return {f"{name}.{key}": plain(x) for key, x in arrays.items()}
