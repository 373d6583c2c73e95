"""A record of a rollout on disk: `record.npz`, its arrays and how it was made; `model.json`, its chain."""

from __future__ import annotations

import os
from os import PathLike
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from holdfast.compiled.externals import state_fields
from holdfast.errors import ResultError, StateError
from holdfast.io.files import LONGEST_NAME, file_path, names_in, one_line, write_atomically
from holdfast.io.model_data import model_data, model_of
from holdfast.io.replaced_folder import replaced_folder
from holdfast.io.result_chunk import Damage, read_arrays, write_arrays
from holdfast.io.result_meta import MODEL, read_bytes
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.fingerprint import fingerprint
from holdfast.simulation.rollout.rollout import Rollout
from holdfast.simulation.rollout.systems import Begun, RolloutRecord, RolloutStatus, RolloutSystems
from holdfast.spatial.scalar import Array

RECORD = "record.npz"
STATUSES = list(RolloutStatus)


class RecordMeta(msgspec.Struct, forbid_unknown_fields=True):
    """How a record was made.

    Attributes:
        format, format_version: which layout this is.
        holdfast: the version that wrote it.
        step: h [s]; None of a record that was put together from arrays.
        every: steps from one record to the next.
        options: of `Rollout.step`.
    """

    format: str = "holdfast-record"
    format_version: int = 1
    holdfast: str = ""
    step: float | None = None
    every: int = 1
    options: dict[str, Any] = {}


def save_record(record: RolloutRecord, folder: str | PathLike[str], overwrite: bool = False) -> Path:
    """Write a record as a folder, and return the folder; see `RolloutRecord.save`."""
    from holdfast import __version__

    place = file_path(folder, "folder")
    _require_free(place, overwrite)
    begun = record.begun
    meta = RecordMeta(holdfast=__version__)
    arrays = {"t": record.t, "stopped": record.stopped} | _under("record", record.arrays) | _of(record.systems, "last")
    if begun is not None:
        options = {name: x if x is None or np.isfinite(x) else None for name, x in begun.options.items()}
        meta = RecordMeta(holdfast=__version__, step=begun.step, every=begun.every, options=options)
        arrays |= _of(begun.systems, "first")
    with replaced_folder(place, lambda path: path.name in (RECORD, MODEL)) as new:
        write_atomically(new / MODEL, msgspec.json.encode(model_data(record.systems.chain)) + b"\n")
        write_arrays(new / RECORD, arrays, "meta", msgspec.to_builtins(meta))
    return place


def load_record(folder: str | PathLike[str], rollout: Rollout | None = None) -> RolloutRecord:
    """Return the record in a folder that `RolloutRecord.save` wrote.

    A control law is a program, and is not in the folder. With the rollout that made the record,
    `record.trajectory(i)` takes the steps of a system again; without it everything else can be had.

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
    chain = model_of(read_bytes(place / MODEL), str(place / MODEL))
    fault = ResultError(f"{place}: damaged: {RECORD} lacks arrays, or has them in other shapes")
    systems = _systems(arrays, "last", chain, fault)
    t, stopped = arrays.get("t", np.zeros(0)), arrays.get("stopped", np.zeros(0))
    recorded = _below(arrays, "record")
    fitting = all(x.shape[:2] == (len(t), len(systems)) for x in recorded.values()) and t.ndim == 1
    if not fitting or stopped.shape != (len(systems),):
        raise fault
    begun = None
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
        begun = Begun(rollout, first, meta.step, meta.every, options)
    return RolloutRecord(t, {name: _as_recorded(name, x) for name, x in recorded.items()}, systems, stopped, begun)


def _require_free(place: Path, overwrite: bool) -> None:
    names = names_in(place, "a folder of a record")
    if names and RECORD not in names:
        raise ResultError(f"{place}: expected a new or empty folder, or an earlier record; found '{names[0]}' in it")
    if names and not overwrite:
        raise ResultError(f"{place}: holds an earlier record; try overwrite=True")


def _of(systems: RolloutSystems, name: str) -> dict[str, Array]:
    """Return all arrays of systems by names that a file can have."""
    own = {"begin": systems.begin, "step_length": systems.step_length}
    return _under(name, own) | _under(f"{name}_arrays", systems.arrays) | _under(f"{name}_inputs", systems.call_inputs)


def _under(name: str, arrays: Any) -> dict[str, Array]:
    return {f"{name}.{key}": _plain(x) for key, x in arrays.items()}


def _below(arrays: dict[str, Array], name: str) -> dict[str, Array]:
    return {key.partition(".")[2]: x for key, x in arrays.items() if key.partition(".")[0] == name}


def _plain(x: Array) -> Array:
    """Return an array of numbers; of statuses their numbers, since reading objects from a file would run code."""
    return x if x.dtype != object else np.vectorize(STATUSES.index, otypes=[np.int64])(x)


def _as_recorded(name: str, x: Array) -> Array:
    return np.array(STATUSES)[x] if name == "status" else x


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
