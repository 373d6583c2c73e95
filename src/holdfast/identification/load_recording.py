"""Recordings in files: tables as `export_csv` writes them, tables with columns of their own, and result folders."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from os import PathLike
from typing import Any

import numpy as np

from holdfast.errors import ResultError
from holdfast.identification.machine.identify_machine import without_object
from holdfast.identification.recording import FREE_BODIES, Recording
from holdfast.identification.signals import SATURATED, prepared
from holdfast.io.columns import NO_UNIT, array_columns
from holdfast.io.files import file_path, one_line, reason_of
from holdfast.io.recording_table import ArmColumnsTable, ColumnsTable, RecordingTable
from holdfast.io.result_reader import load_result
from holdfast.io.save_run import meta_of
from holdfast.io.table_reader import NamedColumns, read_table
from holdfast.io.typed import convert
from holdfast.io.units import FACTORS, factor_to
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.serial_chain import serial_chain
from holdfast.simulation.setting import Setting
from holdfast.simulation.trajectory import RUN_ARRAYS
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs

ARRAY_OF = {"position": "q", "velocity": "qd", "torque": "tau", "current": "current", "used": "used"}
UNITS_OF = {  # of a turning joint, and of a sliding one
    "position": ("rad", "m"),
    "velocity": ("rad/s", "m/s"),
    "torque": ("N m", "N"),
    "current": ("A", "A"),
    "used": ("1", "1"),
}
NOT_MEASURED = ""  # instead of a column: this joint has no torque or current
USUAL_STEPS_OF_GAP = 20.0  # usual intervals between samples, beyond which samples were most likely lost


def load_recording(
    path: str | PathLike[str],
    chain: ClosedChain,
    *,
    columns: RecordingTable | Mapping[str, Any] | None = None,
    inputs: Inputs | None = None,
) -> Recording:
    """Return the recording of a chain in a file: CSV, Parquet, NumPy (.npz), MCAP, or a result folder.

    Without `columns`, titles are those of `export_csv`: `t [s]`, `q left/joint1 [rad]`, `tau left/joint1 [N m]`,
    `wrist_wrench left moment_x [N m]`, `object_pose qw` and so on; an .npz archive has arrays with the names of
    `Recording`, an MCAP file JointState messages with the joints' names. Units in titles may be others, such as [deg],
    or omitted. Other columns are ignored. If one column of an array is present, all of its columns are required.

    Args:
        path: the file, or a result folder.
        chain: the chain whose arms and joints are named in the titles.
        columns: which columns are what, in which units: the table `[recording]` of a scene, as a mapping with its keys,
            or `load_scene(...).recording`; see docs/scenes.md.
        inputs: external wrenches and base motion of the recording, which files do not contain.

    Returns:
        The recording. Its `notes` say what was left out.

    Raises:
        ResultError: the file cannot be read, lacks columns, or has entries that are no numbers; times do not increase.
        SceneError: `columns` has an unknown key or a value of a wrong type.
        StateError: the arrays are not a valid recording, or too short for the `cutoff`.
        MissingExtra: the package that reads Parquet or MCAP files is not installed.
    """
    checks.instance(chain, ClosedChain, "load_recording: chain")
    chain = without_object(chain)
    serial_chain(chain, "load_recording: chain")
    checks.instance(columns, (RecordingTable, Mapping, type(None)), "load_recording: columns")
    path = file_path(path, "path")
    try:
        folder = path.is_dir()
    except OSError as cause:  # a name that is too long
        raise ResultError(f"{one_line(str(path), 80)}: cannot be read: {reason_of(cause)}") from cause
    if folder:
        return Recording.of_run(load_result(path), inputs)
    table = read_table(path)
    if isinstance(columns, Mapping):
        columns = convert(dict(columns), RecordingTable, "columns")
    if columns is None:
        return _of_titles(table, chain, inputs)
    return _of_map(table, chain, columns, inputs)


def recording_of(given: Any, chain: ClosedChain) -> Recording:
    """Return the recording in a `Recording`, a run, a result, or the file at a path."""
    if isinstance(given, Recording):
        return given
    return load_recording(given, chain) if isinstance(given, str | PathLike) else Recording.of_run(given)


def _of_titles(table: NamedColumns, chain: ClosedChain, inputs: Inputs | None) -> Recording:
    """Return the recording in a table with the titles of `export_csv`, or with arrays of the names of `Recording`."""
    free = [f"{body}_{what}" for body in FREE_BODIES for what in ("pose", "twist", "acceleration")]
    meta, names = meta_of(Setting(chain)), ["q", "qd", "qdd", "tau", "wrist_wrench", *free[: 6 if chain.floats else 3]]
    shapes = {name: RUN_ARRAYS[name].shape(chain) for name in names}
    shapes |= {"current": (chain.joint_count,), "used": (chain.joint_count,), "wrist_force": (len(chain.arms), 3)}
    titles = {name: array_columns(name, shapes[name], meta) for name in shapes}
    others = set(table.names()) - {column.name for columns in titles.values() for column in columns}
    found: dict[str, Any] = {}
    for name, columns in titles.items():
        present = [column.name for column in columns if column.name in table]
        numbered = [f"{name} {k}" for k in range(len(columns))]
        if not present and f"{name} 0" in table:  # arrays of an archive
            if table.parts(name) != numbered:
                raise ResultError(
                    f"{table.source}: {name}: expected {len(numbered)} columns, got {len(table.parts(name))}"
                )
            found[name] = np.column_stack([table.column(one) for one in numbered]).reshape(-1, *shapes[name])
            continue
        if not present and name != "q":
            continue
        if absent := [column.name for column in columns if column.name not in table]:
            raise ResultError(
                f"{table.source}: expected a column '{absent[0]}'.{checks.did_you_mean(absent[0], sorted(others))}"
            )
        values = [table.column(column.name) * _title_factor(table, column.name, column.unit) for column in columns]
        found[name] = np.column_stack(values).reshape(-1, *shapes[name])
    t = _times(table, "t", None)
    _require_increasing(table, "t", t, np.arange(len(t)))
    return Recording(t, **found, inputs=inputs, notes=tuple(_notes_on_times("t", t)))


def _title_factor(table: NamedColumns, name: str, si: str) -> float:
    """Return the factor from the unit in a title to an SI unit, 1 without one."""
    unit = table.units.get(name)
    if unit is None or si == NO_UNIT or unit == si:
        return 1.0
    return factor_to(si, unit, f"{table.source}: {name}") if si in FACTORS else 1.0


def _times(table: NamedColumns, name: str, unit: str | None) -> Array:
    """Return the stamps [s], NaN where there is none."""
    if name not in table:
        raise ResultError(
            f"{table.source}: expected a column '{name} [s]'."
            f"{checks.did_you_mean(name, table.names()) or ' Try columns= with its name as time'}"
        )
    said = table.units.get(name)
    if unit and said and factor_to("s", unit, "time_unit") != factor_to("s", said, f"{table.source}: {name}"):
        raise ResultError(f"{table.source}: {name}: its title says [{said}], but time_unit is '{unit}'")
    t = table.column(name, gaps=True)
    return t * factor_to("s", unit or said or "s", f"{table.source}: {name}")


def _of_map(table: NamedColumns, chain: ClosedChain, given: RecordingTable, inputs: Inputs | None) -> Recording:
    """Return the recording in a table whose columns are named by a map."""
    parts = [name for name, joints in chain.joints_of.items() if len(joints)]
    for name in given.arms:
        if name not in chain.joints_of:
            raise ResultError(f"recording: arms: no arm '{name}'.{checks.did_you_mean(name, parts)}")
    if absent := [name for name in parts if name not in given.arms]:
        raise ResultError(f"recording: arms: expected columns of '{absent[0]}', got none")
    of_joints = {key: _joint_arrays(table, chain, given, key, parts) for key in ARRAY_OF}
    found: dict[str, Any] = {ARRAY_OF[key]: x for key, x in of_joints.items() if x is not None}
    found |= _of_wrists(table, chain, given)
    t = _times(table, given.time, given.time_unit)
    kept, notes = _kept_rows(table, given, t, found)
    if not kept.any():
        raise ResultError(f"{table.source}: expected samples to use, got none of {len(t)}")
    _require_increasing(table, given.time, t[kept], np.flatnonzero(kept))
    found = {name: x[kept] for name, x in found.items()}
    counted = found.pop("used", None)
    for name in ("tau", "current"):
        if name in found and np.isnan(found[name]).any():
            known = np.isfinite(found[name]).astype(float)
            counted = known if counted is None else counted * known
            found[name] = np.nan_to_num(found[name])
    if counted is not None:
        found["used"] = (np.nan_to_num(counted) != 0.0).astype(float)
    notes += _notes_on_times(given.time, t[kept])
    made = Recording(t[kept], **found, inputs=inputs, notes=tuple(notes))
    made, efforts = _off_limits(made, chain) if given.at_limits == "drop" else (made, None)
    if given.cutoff is None:
        return made
    ready, report = prepared(made, given.cutoff, limits=efforts, standstill=given.standstill)
    return ready.with_notes(*str(report).splitlines())


def _off_limits(made: Recording, chain: ClosedChain) -> tuple[Recording, Array | None]:
    """Return a recording in which joints at their limits do not count, and the effort limits of measured torques."""
    low, high = chain.position_limits.T
    near = (1.0 - SATURATED) * np.where(np.isfinite(high - low), high - low, 0.0)
    at_end, efforts = (made.q <= low + near) | (made.q >= high - near), None
    if made.tau is not None:
        efforts = np.minimum([joint.effort_limit for joint in chain.freedoms], np.finfo(float).max)
        at_end |= np.abs(made.tau) >= SATURATED * efforts
    if not at_end.any():
        return made, efforts
    pairs = zip(chain.joint_names(), 100.0 * at_end.mean(axis=0), strict=True)
    said = ", ".join(f"'{name}' {share:.2g} %" for name, share in pairs if share)
    used = np.where(at_end, 0.0, 1.0 if made.used is None else made.used)
    return replace(made, used=used).with_notes(f"joints at a limit do not count: {said}"), efforts


def _joint_arrays(
    table: NamedColumns, chain: ClosedChain, given: RecordingTable, key: str, parts: list[str]
) -> Array | None:
    """Return what was recorded of all joints, (samples, n); None if of none."""
    tables: dict[str, ColumnsTable | None] = {name: getattr(given.arms[name], key) for name in parts}
    if not any(tables.values()):
        return None
    found = []
    for name in parts:
        here, joints = f"recording: arms: {name}: {key}", chain.joints_of[name]
        one = tables[name]
        if one is None:
            if key == "used":
                found.append(np.ones((len(next(iter(table.numbers.values()))), len(joints))))
                continue
            other = next(other for other in parts if tables[other] is not None)
            raise ResultError(f"{here}: expected columns of this arm, as '{other}' has them; got none")
        units = [UNITS_OF[key][0 if joint.turns else 1] for joint in joints]
        found.append(_converted(table, one, units, here, key in ("torque", "current")))
    return np.hstack(found)


def _of_wrists(table: NamedColumns, chain: ClosedChain, given: RecordingTable) -> dict[str, Array]:
    """Return what sensors at the wrists recorded, zero for arms without one: wrenches, or forces without moments."""
    sensors = [name for name in chain.names if name in given.arms and given.arms[name].wrist_force is not None]
    moments = [name for name in chain.names if name in given.arms and given.arms[name].wrist_moment is not None]
    if not sensors and not moments:
        return {}
    needed = {*sensors, *moments, *chain.grasps}
    for name, has in (*((name, sensors) for name in needed), *((name, moments) for name in needed if moments)):
        if name not in has:
            raise ResultError(
                f"recording: arms: {name}: expected {'wrist_force' if has is sensors else 'wrist_moment'} of every arm"
                " that holds the object, got none; moments may be left out for all of them"
            )
    samples = len(next(iter(table.numbers.values())))
    wrench = np.zeros((samples, len(chain.arms), 6))
    for name in sensors:
        here, of = f"recording: arms: {name}", chain.names.index(name)
        one: ArmColumnsTable = given.arms[name]
        assert one.wrist_force is not None
        wrench[:, of, 3:] = _converted(table, one.wrist_force, ["N"] * 3, f"{here}: wrist_force")
        if one.wrist_moment is not None:
            wrench[:, of, :3] = _converted(table, one.wrist_moment, ["N m"] * 3, f"{here}: wrist_moment")
    return {"wrist_wrench": wrench} if moments else {"wrist_force": wrench[..., 3:]}


def _converted(table: NamedColumns, given: ColumnsTable, si: list[str], here: str, some: bool = False) -> Array:
    """Return columns in SI units, (samples, columns).

    Args:
        table: the file.
        given: its columns.
        si: the SI unit of each.
        here: the place in the map, for messages.
        some: whether a column may be left out.
    """
    names = _names(table, given.columns, len(si), here)
    signs, scales, offsets = (
        np.broadcast_to(np.asarray(x, dtype=float), len(si)) if np.size(x) in (1, len(si)) else None
        for x in (given.sign, given.scale, given.offset)
    )
    units = [given.unit] * len(si) if not isinstance(given.unit, list) else given.unit
    if signs is None or scales is None or offsets is None or len(units) != len(si):
        raise ResultError(f"{here}: expected unit, sign, scale and offset once or {len(si)} times, for each column")
    if not np.isin(signs, (-1.0, 1.0)).all():
        raise ResultError(f"{here}: sign: expected 1 or -1, got {given.sign}; try scale")
    if not scales.all():
        raise ResultError(f"{here}: scale: expected numbers other than 0, got {given.scale}")
    if twice := sorted({name for name in names if name != NOT_MEASURED and names.count(name) > 1}):
        raise ResultError(f"{here}: expected each column once, got '{twice[0]}' twice")
    found = []
    for name, unit, one, sign, scale, offset in zip(names, units, si, signs, scales, offsets, strict=True):
        if name == NOT_MEASURED and some:
            found.append(np.full(len(next(iter(table.numbers.values()))), np.nan))
            continue
        said, what = table.units.get(name), f"{here}: {name}"
        if unit and said and one in FACTORS and factor_to(one, unit, what) != factor_to(one, said, what):
            raise ResultError(f"{what}: expected the unit of the column's title, [{said}], got '{unit}'")
        readings = table.column(name, gaps=True)
        if np.isnan(readings).all():
            raise ResultError(f"{table.source}: {name}: expected numbers, got an empty column; was it recorded?")
        found.append(sign * scale * factor_to(one, unit or said or one, what) * (readings - offset))
    return np.column_stack(found)


def _names(table: NamedColumns, given: str | list[str], count: int, here: str) -> list[str]:
    """Return the columns that are named one by one, as an array, or by a pattern `q{1}`."""
    if isinstance(given, list):
        names = given
    elif found := re.fullmatch(r"(.*)\{(\d+)\}(.*)", given):
        names = [f"{found[1]}{int(found[2]) + k}{found[3]}" for k in range(count)]
    elif given in table:
        names = [given]
    else:
        names = table.parts(given)
        if not names and count > 1:
            raise ResultError(
                f"{here}: expected an array '{given}' with {count} columns in {table.source}, got none;"
                f" try a pattern such as '{given}{{1}}'.{checks.did_you_mean(given, table.names())}"
            )
        names = names or [given]
    if len(names) != count:
        raise ResultError(f"{here}: expected {count} columns, got {len(names)}")
    return names


def _kept_rows(
    table: NamedColumns, given: RecordingTable, t: Array, found: dict[str, Array]
) -> tuple[Array, list[str]]:
    """Return which rows are used, (samples,), and remarks on the others; refuse bad ones, unless they are dropped."""
    kept, notes, drop = np.ones(len(t), bool), list[str](), given.bad_rows == "drop"
    if given.valid is not None:
        kept &= table.column(given.valid, gaps=True) > 0.0
        notes += [f"{given.valid}: {int((~kept).sum())} rows are not valid"] if not kept.all() else []
    stamped = t[np.isfinite(t)]
    if given.begin is not None or given.end is not None:
        if not len(stamped):
            raise ResultError(f"{table.source}: {given.time}: expected times, got none")
        after = t - stamped[0]
        low, high = given.begin or 0.0, np.inf if given.end is None else given.end
        if not low < high:
            raise ResultError(f"recording: end: expected a time after the begin at {low:g} s, got {high:g}")
        with np.errstate(invalid="ignore"):
            kept &= (after >= low) & (after <= high)
    needed = {"time": t[:, None]} | {k: x for k, x in found.items() if k not in ("tau", "current", "used")}
    lacking = np.zeros(len(t), bool)
    for name, x in needed.items():
        missing = kept & ~np.isfinite(x.reshape(len(x), -1)).all(axis=1)
        _refuse_missing(table, given, name, missing, drop)
        lacking |= missing
    if lacking.any():
        notes.append(f"{int(lacking.sum())} rows with missing numbers were dropped")
    kept &= ~lacking
    for name in ("tau", "current"):
        if name in found:
            unknown = np.isnan(found[name]) & ~np.isnan(found[name]).all(axis=0) & kept[:, None]
            _refuse_missing(table, given, name, np.asarray(unknown.any(axis=1)), drop)
            notes += [f"{int(unknown.sum())} missing entries of {name} do not count"] if unknown.any() else []
    last, repeated = -np.inf, np.zeros(len(t), bool)
    if drop:
        for k in np.flatnonzero(kept).tolist():
            repeated[k] = t[k] <= last
            last = max(last, float(t[k]))
        if repeated.any():
            notes.append(f"{given.time}: {int(repeated.sum())} rows whose stamps do not increase were dropped")
    return kept & ~repeated, notes


def _refuse_missing(table: NamedColumns, given: RecordingTable, name: str, missing: Array, drop: bool) -> None:
    """Refuse missing numbers of an array: name the first of them, and its column."""
    if drop or not missing.any():
        return
    k = int(np.flatnonzero(missing)[0])
    keys = {array: key for key, array in ARRAY_OF.items()} | {"wrist_wrench": "wrist_force"}
    which = [given.time] if name == "time" else []
    for one in given.arms.values() if not which else ():
        of = getattr(one, keys.get(name, name))
        if of is not None:
            listed = of.columns if isinstance(of.columns, list) else [*map(str, table.names())]
            which += [n for n in listed if n in table.numbers and not np.isfinite(table.numbers[n][k])]
    raise ResultError(
        f"{table.source}: {table.place(k)}, {', '.join(dict.fromkeys(which[:4])) or name}: expected a number, got none"
        f' (empty or NaN), in {int(missing.sum())} of {len(missing)} rows; try bad_rows = "drop", or begin and end'
    )


def _require_increasing(table: NamedColumns, name: str, t: Array, samples: Array) -> None:
    """Refuse times that do not increase: name the first, and the likely cause."""
    if np.isnan(t).any():
        table.column(name)
    wrong = np.flatnonzero(np.diff(t) <= 0.0)
    if not len(wrong):
        return
    k = int(wrong[0])
    back = t[k + 1] < t[k]
    cause = "the clock was set, or two logs follow each other" if back else "a row was logged twice, or digits were cut"
    raise ResultError(
        f"{table.source}: {table.place(int(samples[k + 1]))}, {name}: expected increasing times, got {t[k + 1]:.12g} s"
        f' after {t[k]:.12g} s ({len(wrong)} times); most likely {cause}; try columns= with bad_rows = "drop"'
    )


def _notes_on_times(name: str, t: Array) -> list[str]:
    """Return a remark on gaps."""
    steps = np.diff(t)
    usual = float(np.median(steps)) if len(steps) > 1 else np.inf
    far = int((steps > USUAL_STEPS_OF_GAP * usual).sum())
    if not far:
        return []
    k = int(np.argmax(steps))
    gaps = "a gap of" if far == 1 else f"{far} gaps, the longest"
    return [
        f"{name}: {gaps} {steps[k]:.3g} s at {t[k]:.6g} s, {steps[k] / usual:.3g} times the usual interval; most likely"
        " samples were lost"
    ]
