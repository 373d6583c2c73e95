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
from holdfast.io.files import LONGEST_NAME, file_path, one_line
from holdfast.io.model_data import model_of
from holdfast.io.record_writer import RECORD, RecordMeta
from holdfast.io.result_chunk import Damage, read_arrays
from holdfast.io.result_meta import MODEL, read_bytes
from holdfast.io.stored_arrays import STATUSES, StoredArrays, piece_name, read_piece
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.fingerprint import fingerprint
from holdfast.questions.arrays import state_fields
from holdfast.simulation.rollout.record import RolloutArguments, RolloutRecord
from holdfast.simulation.rollout.rollout import Rollout
from holdfast.simulation.rollout.systems import RolloutSystems
from holdfast.spatial.scalar import Array


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
    if not os.path.isfile(place / RECORD):  # Path.is_file raises at names that are too long
        shown = one_line(str(place), LONGEST_NAME)
        raise ResultError(f"{shown}: expected a folder that RolloutRecord.save wrote, with {RECORD} in it")
    try:
        arrays, data = read_arrays(place / RECORD, "meta")
        meta = msgspec.convert(data, RecordMeta)
    except (Damage, msgspec.ValidationError) as cause:
        raise ResultError(f"{place}: damaged: {cause}") from cause
    known = RecordMeta()
    if (meta.format, meta.format_version) != (known.format, known.format_version):
        raise ResultError(f"{place}: written by holdfast {meta.holdfast} in another format; try that version")
    if not meta.pieces:
        raise ResultError(f"{place}: no records yet: the rollout has just begun, or ended before its first flush")
    chain = model_of(read_bytes(place / MODEL), str(place / MODEL))
    fault = ResultError(f"{place}: damaged: {RECORD} lacks arrays, or has them in other shapes")
    systems, stopped = _systems(arrays, "last", chain, fault), arrays.get("stopped", np.zeros(0))
    if stopped.shape != (len(systems),):
        raise fault
    t = _times(place, meta, len(systems))
    last = f"{t[-1]:.6g} s" if len(t) else "none"
    note = "" if meta.complete else f"incomplete, up to t = {last}: interrupted, or still running"
    arguments = None
    if rollout is not None and meta.step is not None:
        first = _systems(arrays, "first", chain, fault)
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
    stored = StoredArrays(place, tuple(meta.pieces), tuple(meta.names))
    return RolloutRecord(t, stored, systems, stopped, arguments, note)


def _times(place: Path, meta: RecordMeta, systems: int) -> Array:
    """Return the times of all records; looks at every piece.

    Raises:
        ResultError: a piece is missing or damaged, or is of other systems.
    """
    times, shapes = list[Array](), None
    for k, count in enumerate(meta.pieces):
        try:
            t, recorded = read_piece(place, k, count, tuple(meta.names))
        except Damage as damage:
            raise ResultError(f"{place}: damaged: {damage}") from damage
        here = {name: x.shape[1:] for name, x in recorded.items()}
        if any(shape[:1] != (systems,) for shape in here.values()) or here != (shapes or here):
            raise ResultError(f"{place}: damaged: {piece_name(k)} is not of these systems")
        times.append(t)
        shapes = here
    return np.concatenate(times)


def parts_of_record(record: RolloutRecord) -> Iterator[RolloutRecord]:
    """Yield a record piece by piece; see `RolloutRecord.parts`."""
    if not isinstance(record.arrays, StoredArrays):
        yield record
        return
    for t, arrays in record.arrays.parts():
        yield replace(record, t=t, arrays=arrays, arguments=None)


def _below(arrays: dict[str, Array], name: str) -> dict[str, Array]:
    return {key.partition(".")[2]: x for key, x in arrays.items() if key.partition(".")[0] == name}


def _systems(arrays: dict[str, Array], name: str, chain: ClosedChain, fault: ResultError) -> RolloutSystems:
    """Return the systems that are under a name.

    Raises:
        ResultError: `fault`, if they cannot be systems of the chain.
    """
    own, carried, inputs = (_below(arrays, key) for key in (name, f"{name}_arrays", f"{name}_inputs"))
    begin, length = own.get("begin", np.zeros(())), own.get("step_length", np.zeros(()))
    needed = {"count", "code", *state_fields(chain)}
    code = carried.get("code", np.zeros(0))
    if not (
        begin.ndim == 1
        and length.shape == begin.shape
        and needed <= carried.keys()
        and all(x.shape[:1] == begin.shape for x in carried.values())
        and all(x.ndim and len(x) in (1, len(begin)) for x in inputs.values())
        and all(x.dtype == np.float64 for x in (*carried.values(), begin, length))
        and carried["q"].shape[1:] == (chain.joint_count,)
        and np.isin(code, np.arange(len(STATUSES))).all()
    ):
        raise fault
    systems = RolloutSystems(chain, carried, begin, length)
    systems.call_inputs = inputs
    return systems
