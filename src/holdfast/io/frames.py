"""Runs and records as tables of pandas and data sets of xarray, under the names and units of exported tables."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any

import numpy as np

from holdfast.errors import MissingExtra
from holdfast.io.columns import NO_UNIT, array_columns, columns, rows
from holdfast.io.result_meta import ResultMeta
from holdfast.io.save_run import meta_of
from holdfast.questions.arrays import Row, Shape
from holdfast.simulation.rollout.record import RolloutRecord
from holdfast.simulation.setting import Setting
from holdfast.simulation.trajectory import RUN_ARRAYS, Trajectory, array_names
from holdfast.spatial.scalar import Array


def frame_of_run(run: Trajectory) -> Any:
    """Return a run as a pandas DataFrame, the table of `export_csv`.

    Raises:
        MissingExtra: pandas is not installed.
        StateError: a run that does not know its chain.
    """
    meta = meta_of(run.require_setting())
    return _library("pandas").DataFrame(rows(run), columns=[column.title for column in columns(meta, run)])


def data_set_of_run(run: Trajectory) -> Any:
    """Return a run as an xarray Dataset: its arrays over `t`, joints and arms by name, each with its unit.

    Raises:
        MissingExtra: xarray is not installed.
        StateError: a run that does not know its chain.
    """
    meta = meta_of(run.require_setting())
    arrays = {name: getattr(run, name) for name in array_names() if name != "t"}
    return _data_set(arrays, {"t": run.t}, meta)


def frame_of_record(record: RolloutRecord) -> Any:
    """Return a record as a pandas DataFrame: a row for each system and time, which index it.

    Raises:
        MissingExtra: pandas is not installed.
    """
    pandas, meta = _library("pandas"), _meta_of_record(record)
    times, count = len(record.t), len(record.systems)
    by_title = {}
    for name, array in record.arrays.items():
        titles = [column.title for column in array_columns(name, array.shape[2:], meta)]
        entries = np.moveaxis(array, 0, 1).reshape(count * times, -1).T
        by_title |= dict(zip(titles, entries, strict=True))
    index = pandas.MultiIndex.from_product([range(count), record.t], names=["system", "t [s]"])
    return pandas.DataFrame(by_title, index=index)


def data_set_of_record(record: RolloutRecord) -> Any:
    """Return a record as an xarray Dataset: its arrays over `t` and `system`, joints and arms by name.

    Raises:
        MissingExtra: xarray is not installed.
    """
    over = {"t": record.t, "system": np.arange(len(record.systems))}
    found = _data_set({k: x for k, x in record.arrays.items() if x.dtype != object}, over, _meta_of_record(record))
    status = ("system", [status.name for status in record.systems.status])
    return found.assign_coords(status=status, stopped=("system", record.stopped))


def _data_set(arrays: Mapping[str, Array], over: Mapping[str, Array], meta: ResultMeta) -> Any:
    xarray = _library("xarray")
    coordinates: dict[str, Any] = {**over, "joint": meta.joints, "arm": meta.arms}
    variables = {}
    for name, array in arrays.items():
        row, shape = RUN_ARRAYS.get(name), array.shape[len(over) :]
        called = f"{name}_of_system" if name in over else name
        said = {"unit": "SI"} if row is None else {"unit": _unit(row), "long_name": row.meaning}
        variables[called] = ((*over, *_axes(name, shape, coordinates)), array, said)
    return xarray.Dataset(variables, coordinates)


def _axes(name: str, shape: Shape, coordinates: Mapping[str, Any]) -> list[str]:
    """Return the names of an array's axes after time and system."""
    first = RUN_ARRAYS[name].axes[:1] if name in RUN_ARRAYS else ()
    along = {("n",): "joint", ("arms",): "arm"}.get(first)
    if along and shape[:1] == (len(coordinates[along]),):
        return [along, "moment_force"][: len(shape)]
    return [f"{name}_{k}" for k in range(len(shape))]


def _unit(row: Row) -> str:
    """Return the unit of an array, or those of its entries."""
    return ", ".join(dict.fromkeys(unit or NO_UNIT for _, unit in row.entries)) or row.unit or NO_UNIT


def _meta_of_record(record: RolloutRecord) -> ResultMeta:
    return meta_of(Setting(record.systems.chain))


def _library(name: str) -> Any:
    try:
        return import_module(name)
    except ImportError as cause:
        raise MissingExtra(f"this needs {name}; try pip install 'holdfast[{name}]'") from cause
