"""Which columns of a recording are what: the table `[recording]` of a scene, and an argument of `load_recording`."""

from __future__ import annotations

from typing import Literal

import msgspec

OneOrEach = float | list[float]


class ColumnsTable(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """Columns, one for each joint or axis, and what makes them SI numbers: sign * scale * unit * (reading - offset).

    `columns` is a list of names, or one text: the name of an array with several columns, or a text with a number in
    braces, `q{1}` for q1, q2 and so on. Unit, sign, scale and offset are one for all columns, or a list.
    """

    columns: str | list[str]
    unit: str | list[str] | None = None
    sign: OneOrEach = 1.0
    scale: OneOrEach = 1.0
    offset: OneOrEach = 0.0


class ArmColumnsTable(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """The columns of an arm, or of the trunk, and of the sensor in its wrist."""

    position: ColumnsTable
    velocity: ColumnsTable | None = None
    torque: ColumnsTable | None = None
    current: ColumnsTable | None = None
    used: ColumnsTable | None = None
    wrist_force: ColumnsTable | None = None
    wrist_moment: ColumnsTable | None = None


class RecordingTable(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """How a recording is read: its time, the columns of every arm, what of it is used, and how it is filtered.

    Rows whose `valid` column is 0 are left out, and those outside of `begin` to `end` after the first stamp. Rows with
    missing positions or repeated stamps are refused, or left out; with "drop", missing measurements do not count. With
    `at_limits` "drop", a joint does not count where its torque is at its effort limit or its position at the end of its
    range. A `cutoff` filters as `identification.prepared` does.
    """

    arms: dict[str, ArmColumnsTable]
    file: str | None = None
    time: str = "t"
    time_unit: str | None = None
    valid: str | None = None
    begin: float | None = None
    end: float | None = None
    bad_rows: Literal["refuse", "drop"] = "refuse"
    at_limits: Literal["use", "drop"] = "use"
    cutoff: float | None = None
    standstill: float = 0.0
