"""A run as tables: one row a sample, and one row an occurrence; every number has a named column with its unit."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from holdfast.io.result_meta import ResultMeta
from holdfast.model.joint_types import JOINT_TYPES
from holdfast.simulation.events import Occurrence
from holdfast.simulation.margins import JOINT_QUANTITIES
from holdfast.simulation.trajectory import Trajectory, array_names
from holdfast.spatial.scalar import Array

NO_UNIT = "1"


class Column(NamedTuple):
    """One number of every sample.

    Attributes:
        name: the array, then what it is in it, such as `grasp_wrench left force_x`.
        unit: of the number; `1` where it has none.
    """

    name: str
    unit: str

    @property
    def title(self) -> str:
        """The name with its unit, such as `t [s]`."""
        return self.name if self.unit == NO_UNIT else f"{self.name} [{self.unit}]"


def columns(meta: ResultMeta, run: Trajectory) -> list[Column]:
    """Return the columns of a run's table.

    Args:
        meta: of the run.
        run: the run or a part of it.
    """
    found = []
    for array in array_names():
        found += _of_array(array, getattr(run, array).shape[1:], meta)
    return found


def labels_of(array: str, shape: tuple[int, ...], meta: ResultMeta) -> list[str]:
    """Return the titles of an array's columns, those of a rollout's own arrays too.

    Args:
        array: its name.
        shape: of one sample.
        meta: of the run.
    """
    return [column.title for column in _of_array(array, shape, meta)]


def _of_array(array: str, shape: tuple[int, ...], meta: ResultMeta) -> list[Column]:
    found = []
    for labels in product(*_axes(array, shape, meta)):
        unit = next((one.unit for one in labels if one.unit), UNIT.get(array, meta.units.get(array, NO_UNIT)))
        found.append(Column(" ".join([array, *(label.name for label in labels)]), unit))
    return found


def rows(run: Trajectory) -> Array:
    """Return the table of a run or a part of it, (samples, columns)."""
    return np.column_stack([getattr(run, array).reshape(len(run), -1) for array in array_names()])


def _axes(array: str, shape: tuple[int, ...], meta: ResultMeta) -> list[list[Column]]:
    """Return name and unit of every place along each axis of an array; an empty unit leaves it open."""
    if array in PER_JOINT:
        angular, linear = PER_JOINT[array]
        turning = {kind for kind, row in JOINT_TYPES.items() if row.turns}
        units = [angular if kind in turning else linear for kind in meta.joint_kinds]
        axes = [[Column(*pair) for pair in zip(meta.joints, units, strict=True)]]
    elif array == "work":
        axes = [_named(meta.work_terms, "J")]
    elif array in WRENCHES:
        axes = [_named(meta.arms), WRENCH]
    elif array in PER_ARM:
        axes = [_named(meta.arms, PER_ARM[array])]
    else:
        axes = FIXED.get(array, [])
    if tuple(map(len, axes)) == shape:
        return axes
    return [_named([str(i) for i in range(size)]) for size in shape]  # an array that came after this list


def _named(names: Sequence[str], unit: str = "") -> list[Column]:
    return [Column(name, unit) for name in names]


def _xyz(name: str, unit: str) -> list[Column]:
    return _named([f"{name}_x", f"{name}_y", f"{name}_z"], unit)


PER_JOINT = {"q": ("rad", "m"), "qd": ("rad/s", "m/s"), "qdd": ("rad/s^2", "m/s^2"), "tau": ("N m", "N")}
PER_ARM = {
    "load_share": NO_UNIT,
    "holding": NO_UNIT,
    "spin": "rad",
    "margin": "N",
    "best_margin": "N",
    "worst_margin": "N",
    "lowest_margin": "N",
    "lowest_margin_time": "s",
}
WRENCHES = ("grasp_wrench", "internal_wrench", "wrist_wrench", "base_wrench")
WRENCH = _xyz("moment", "N m") + _xyz("force", "N")
MOMENTUM = _xyz("angular", "N m s") + _xyz("linear", "N s")
POSE = _named(["qw", "qx", "qy", "qz"], NO_UNIT) + _named(["x", "y", "z"], "m")
TWIST = _xyz("omega", "rad/s") + _xyz("v", "m/s")
ACCELERATION = _xyz("omega_dot", "rad/s^2") + _xyz("v_dot", "m/s^2")
FIXED = {
    "object_pose": [POSE],
    "object_twist": [TWIST],
    "object_acceleration": [ACCELERATION],
    "base_pose": [POSE],
    "base_twist": [TWIST],
    "base_acceleration": [ACCELERATION],
    "trunk_base_wrench": [WRENCH],
    "lowest_joint_margin": [
        [Column("position", "rad or m"), Column("rate", "rad/s or m/s"), Column("effort", "N m or N")]
    ],
    "lowest_joint_margin_time": [_named(JOINT_QUANTITIES, "s")],
    "lowest_joint": [_named(JOINT_QUANTITIES, NO_UNIT)],
    "position_gap": [_named(["before", "after"], "m or rad")],
    "velocity_gap": [_named(["before", "after"], "m/s or rad/s")],
    "momentum": [MOMENTUM],
    "momentum_rate": [WRENCH],
    "base_impulse": [MOMENTUM],
}
UNIT = {"impact": "J"}  # of numbers whose entry in `UNITS` is a sentence

TEXTS = ("kind", "name", "text", "quantity")
NUMBERS = {"t": "s", "lowest": "SI", "lowest_time": "s", "energy_change": "J"}  # lowest is of the quantity's unit
NUMBERS |= {"rank": NO_UNIT, "generic_rank": NO_UNIT}
IMPULSES = ("impulses", "base_impulses")
OF_TRUNK = "trunk_base_impulse"

Cell = str | float | None


def occurrence_columns(meta: ResultMeta) -> list[Column]:
    """Return the columns of `occurrence_row`: numbers, texts, the impulses on and of every arm, and below a trunk."""
    impulses = [
        Column(f"{field} {arm} {part.name}", part.unit) for field, arm, part in product(IMPULSES, meta.arms, MOMENTUM)
    ]
    below = [Column(f"{OF_TRUNK} {part.name}", part.unit) for part in MOMENTUM] if meta.trunk else []
    numbers, texts = (Column(*pair) for pair in NUMBERS.items()), (Column(name, NO_UNIT) for name in TEXTS)
    return [*numbers, *texts, *impulses, *below]


def occurrence_row(one: Occurrence, meta: ResultMeta) -> list[Cell]:
    """Return an occurrence as a row; None where it has no such entry."""
    row: list[Cell] = [getattr(one, name) for name in (*NUMBERS, *TEXTS)]
    widths = dict.fromkeys(IMPULSES, len(meta.arms) * len(MOMENTUM)) | ({OF_TRUNK: len(MOMENTUM)} if meta.trunk else {})
    for field, width in widths.items():
        given = np.ravel(getattr(one, field)).tolist()
        row += given or [None] * width
    return row
