"""A run as tables: one row a sample, and one row an occurrence; every number has a named column with its unit."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np

from holdfast.io.result_meta import ResultMeta
from holdfast.model.joint_types import JOINT_TYPES
from holdfast.questions.arrays import Row, Shape
from holdfast.simulation.events import Occurrence
from holdfast.simulation.trajectory import RUN_ARRAYS, Trajectory
from holdfast.spatial.scalar import Array

NO_UNIT = "1"


class TableColumn(NamedTuple):
    """One number of every sample.

    Attributes:
        name: the array and the entry, such as `grasp_wrench left force_x`.
        unit: unit of the number; `1` for none.
    """

    name: str
    unit: str

    @property
    def title(self) -> str:
        """The name with its unit, such as `t [s]`."""
        return self.name if self.unit == NO_UNIT else f"{self.name} [{self.unit}]"


def columns(meta: ResultMeta, run: Trajectory) -> list[TableColumn]:
    """Return the columns of a run's table.

    Args:
        meta: metadata of the run.
        run: the run or a part of it.
    """
    return [one for name in run.recorded for one in array_columns(name, getattr(run, name).shape[1:], meta)]


def array_columns(array: str, shape: Shape, meta: ResultMeta) -> list[TableColumn]:
    """Return the columns of an array; those of an array that no run has are numbered.

    Args:
        array: its name.
        shape: of one sample.
        meta: metadata of the run.
    """
    row = RUN_ARRAYS.get(array)
    axes = [] if row is None or callable(row.axes) else [_along(axis, row, meta) for axis in row.axes]
    if tuple(map(len, axes)) != shape:
        axes = [[TableColumn(str(i), "") for i in range(size)] for size in shape]
    found = []
    for labels in product(*axes):
        unit = next((one.unit for one in labels if one.unit), "" if row is None else row.unit)
        found.append(TableColumn(" ".join([array, *(label.name for label in labels)]), unit or NO_UNIT))
    return found


def _along(axis: int | str, row: Row, meta: ResultMeta) -> list[TableColumn]:
    """Return name and unit of every place along an axis of an array; the unit is empty if the axis does not decide."""
    if axis == "arms":
        return [TableColumn(name, "") for name in meta.rows or meta.arms]
    if axis == "touches":
        return [TableColumn(name, "") for name in meta.touches]
    if axis != "n":
        return [TableColumn(*entry) for entry in row.entries]
    turning, sliding = row.unit.split(" or ")
    turn = {kind for kind, joint in JOINT_TYPES.items() if joint.turns}
    return [
        TableColumn(name, turning if kind in turn else sliding)
        for name, kind in zip(meta.joints, meta.joint_kinds, strict=True)
    ]


def rows(run: Trajectory) -> Array:
    """Return the table of a run or a part of it, (samples, columns)."""
    return np.column_stack([getattr(run, array).reshape(len(run), -1) for array in run.recorded])


TEXTS = ("kind", "name", "text", "quantity")
# units of an occurrence's numbers; `lowest` has the unit of the quantity
AMOUNTS = {"t": "s", "lowest": "SI", "lowest_time": "s", "energy_change": "J", "rank": NO_UNIT, "generic_rank": NO_UNIT}
IMPULSES, TRUNK_IMPULSE = ("impulses", "base_impulses"), "trunk_base_impulse"

Cell = str | float | None


def occurrence_columns(meta: ResultMeta) -> list[TableColumn]:
    """Return the columns of `occurrence_row`: numbers, texts, impulses of every arm and base, of a trunk's base."""
    parts = RUN_ARRAYS["base_impulse"].entries
    named = {"impulses": meta.rows or meta.arms, "base_impulses": [] if meta.rows else meta.arms}
    fields = [f"{field} {name}" for field in IMPULSES for name in named[field]] + [TRUNK_IMPULSE] * meta.trunk
    impulses = [TableColumn(f"{field} {part}", unit) for field, (part, unit) in product(fields, parts)]
    numbers = [TableColumn(*pair) for pair in (AMOUNTS | dict.fromkeys(TEXTS, NO_UNIT)).items()]
    return [*numbers, *impulses]


def occurrence_row(one: Occurrence, meta: ResultMeta) -> list[Cell]:
    """Return an occurrence as a row, with None for entries that it does not have."""
    row: list[Cell] = [getattr(one, name) for name in (*AMOUNTS, *TEXTS)]
    of_bases = 0 if meta.rows else 6 * len(meta.arms)
    widths = {"impulses": 6 * len(meta.rows or meta.arms), "base_impulses": of_bases, TRUNK_IMPULSE: 6 * meta.trunk}
    for field, width in widths.items():
        row += np.ravel(getattr(one, field)).tolist() or [None] * width
    return row
