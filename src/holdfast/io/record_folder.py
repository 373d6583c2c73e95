"""Reading of a record of a rollout from its folder; `record_writer` describes the files."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from os import PathLike
from pathlib import Path

import msgspec
import numpy as np

from holdfast.errors import ResultError, StateError
from holdfast.io.files import file_path
from holdfast.io.model_data import model_of
from holdfast.io.result_meta import MODEL
from holdfast.io.store import read_manifest, times_of_chunks
from holdfast.io.stored_arrays import RECORD, STATUSES, RecordMeta, StoredArrays, read_piece
from holdfast.io.stored_file import Damage, read_arrays, stored
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.fingerprint import fingerprint
from holdfast.questions.arrays import state_fields
from holdfast.simulation.rollout.record import RolloutArguments, RolloutRecord
from holdfast.simulation.rollout.rollout import Rollout
from holdfast.simulation.rollout.systems import RolloutSystems
from holdfast.spatial.scalar import Array

OLD = "record.npz"  # manifest and systems of holdfast 0.1


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
        and np.isin(code, np.arange(len(STATUSES))).all()
    ):
        raise Damage("systems: arrays are missing, or have other shapes: damaged")
    systems = RolloutSystems(chain, carried, begin, length)
    systems.call_inputs = inputs
    return systems
