"""What happened at single instants of a run as a table: one row an occurrence."""

from __future__ import annotations

from itertools import product

import numpy as np

from holdfast.io.columns import MOMENTUM, NO_UNIT, Column
from holdfast.io.result_meta import ResultMeta
from holdfast.simulation.trajectory import Occurrence

TEXTS = ("kind", "name", "text", "quantity")
NUMBERS = {"t": "s", "lowest": "SI", "lowest_time": "s", "energy_change": "J"}  # lowest is of the quantity's unit
IMPULSES = ("impulses", "base_impulses")

Entry = str | float | None


def occurrence_columns(meta: ResultMeta) -> list[Column]:
    """Return the columns of `occurrence_row`: numbers, texts, the impulses on and of every arm."""
    impulses = [
        Column(f"{field} {arm} {part.name}", part.unit) for field, arm, part in product(IMPULSES, meta.arms, MOMENTUM)
    ]
    return [*(Column(*pair) for pair in NUMBERS.items()), *(Column(name, NO_UNIT) for name in TEXTS), *impulses]


def occurrence_row(one: Occurrence, meta: ResultMeta) -> list[Entry]:
    """Return an occurrence as a row; None where it has no such entry."""
    row: list[Entry] = [getattr(one, name) for name in (*NUMBERS, *TEXTS)]
    for field in IMPULSES:
        given = np.ravel(getattr(one, field)).tolist()
        row += given or [None] * (len(meta.arms) * len(MOMENTUM))
    return row
