"""Postures: joint positions in which loops are closed, and measured poses of frames."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from os import PathLike
from typing import Any

import numpy as np

from holdfast.errors import ResultError, StateError
from holdfast.identification.recording import Recording
from holdfast.io.files import file_path
from holdfast.io.result_reader import load_result
from holdfast.io.table_reader import read_table
from holdfast.io.units import factor_to
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.names import called
from holdfast.spatial import rotation
from holdfast.spatial.frozen import REQUIRED, ArrayField, Frozen, FrozenDict, making
from holdfast.spatial.pose import Pose, PoseField
from holdfast.spatial.scalar import Array


@called
@dataclass(frozen=True, eq=False)
class FrameMeasurement(Frozen):
    """What a tracker, a camera or a robot's controller saw of a frame, posture by posture.

    The measured pose is that of a marker on the frame in the axes of the sensor:
    sensor^-1 frame marker, or its origin alone.

    Attributes:
        frame: "arm" for an arm's tip, "arm/link" for a link or frame, "trunk/link", or the name of an object.
        poses: (postures, 7) wxyz_xyz, or (postures, 3) positions; NaN where nothing was seen.
        marker: pose of the marker on the frame; the guess, if it is sought.
        sensor: pose of the sensor in the world; the guess, if it is sought.
    """

    frame: str
    poses: ArrayField = REQUIRED
    marker: PoseField = field(default_factory=making(Pose.identity))
    sensor: PoseField = field(default_factory=making(Pose.identity))

    def __post_init__(self) -> None:
        put = object.__setattr__
        checks.instance(self.frame, str, "measurement: frame")
        poses = with_gaps(self.poses, "measurement: poses")
        if poses.ndim != 2 or poses.shape[1] not in (3, 7):
            raise StateError(
                f"measurement: poses: expected shape (postures, 7) or (postures, 3), got shape {poses.shape}"
            )
        put(self, "poses", poses)
        for name in ("marker", "sensor"):
            put(self, name, checks.pose(getattr(self, name), f"measurement: {name}"))
        for row in poses[self.seen] if self.posed else ():
            checks.pose_numbers(row, "measurement: poses")

    @property
    def posed(self) -> bool:
        """Whether attitudes were measured, too."""
        return self.poses.shape[1] == 7

    @property
    def seen(self) -> Array:
        """(postures,) whether the frame was seen."""
        return np.asarray(np.isfinite(self.poses).all(axis=1))

    @property
    def targets(self) -> tuple[Array, Array]:
        """(postures, 3, 3) attitudes and (postures, 3) positions; the identity where nothing was seen."""
        seen, count = self.seen, len(self.poses)
        R, p = np.tile(np.eye(3), (count, 1, 1)), np.where(seen[:, None], self.poses[:, -3:], 0.0)
        if self.posed:
            R[seen] = [rotation.from_quaternion(row[:4]) for row in self.poses[seen]]
        return R, p


@called
@dataclass(frozen=True, eq=False)
class Postures(Frozen):
    """Postures in which a chain stood still, in any order.

    Attributes:
        q: (postures, n) joint positions [rad or m]; NaN for a joint that was not measured.
        holds: by name of a grasp or loop, (postures,) whether it was closed; those not named were closed in all. The
            key of a grasp is that of `ClosedChain.grasps`.
        measured: measurements by name.
    """

    q: ArrayField = REQUIRED
    holds: Mapping[Any, Any] = field(default_factory=dict)
    measured: Mapping[str, FrameMeasurement] = field(default_factory=dict)

    def __post_init__(self) -> None:
        q = with_gaps(self.q, "postures: q")
        if q.ndim != 2 or not len(q):
            raise StateError(f"postures: q: expected shape (postures, joints), got shape {q.shape}")
        if not isinstance(self.holds, Mapping) or not isinstance(self.measured, Mapping):
            raise StateError("postures: expected holds and measured as mappings from a name")
        holds = {}
        for name, given in self.holds.items():
            flags = np.asarray(given)
            if flags.dtype != bool or flags.shape != (len(q),):
                raise StateError(
                    f"postures: holds: {name!r}: expected {len(q)} booleans, got {flags.dtype}, shape {flags.shape}"
                )
            holds[name] = flags.copy()
        for name, one in self.measured.items():
            checks.instance(one, FrameMeasurement, f"postures: measured: {name!r}", StateError)
            if len(one.poses) != len(q):
                raise StateError(
                    f"postures: measured: {name!r}: expected {len(q)} rows, as q has, got {len(one.poses)}"
                )
        object.__setattr__(self, "q", q)
        object.__setattr__(self, "holds", FrozenDict({name: checks.read_only(x) for name, x in holds.items()}))
        object.__setattr__(self, "measured", FrozenDict(self.measured))

    def __len__(self) -> int:
        return len(self.q)

    def part(self, chosen: Any) -> Postures:
        """Return some of the postures, by a mask, a slice or indices."""
        measured = {
            name: FrameMeasurement(one.frame, one.poses[chosen], one.marker, one.sensor)
            for name, one in self.measured.items()
        }
        return Postures(self.q[chosen], {name: x[chosen] for name, x in self.holds.items()}, measured)


def with_gaps(value: Any, what: str) -> Array:
    """Return a read-only array of numbers of which some may be NaN, but none infinite.

    Raises:
        StateError: it is no array of real numbers.
    """
    a = np.array(checks.real_array(value, what, "an array of numbers", StateError), dtype=float)
    if np.isinf(a).any():
        raise StateError(f"{what}: expected finite numbers, or NaN where nothing was measured; got an infinite one")
    return checks.read_only(a)


def load_postures(path: str | PathLike[str], chain: ClosedChain) -> Postures:
    """Return the postures in a table, with the column titles of `export_csv`: `q left/joint1 [rad]`.

    The titles may also be the joints' names alone, `left/joint1`, and their units others, such as [deg]. A column
    `holds NAME` with 0 and 1 says in which postures a grasp or loop was closed. Other columns are ignored.

    Args:
        path: a file that ends in .csv, .parquet, .npz or .mcap, or the result folder of a run.
        chain: the chain whose joints are named in the titles.

    Raises:
        ResultError: the file cannot be read, or lacks the column of a joint.
    """
    path = file_path(path, "path")
    if os.path.isdir(path):
        return Postures(load_result(path).trajectory.q)
    table, columns = read_table(path), []
    for name, joint in zip(chain.joint_names(), chain.all_joints, strict=True):
        title = next((one for one in (f"q {name}", name) if one in table), None)
        if title is None:
            raise ResultError(f"{path}: expected a column 'q {name}'.{checks.did_you_mean(f'q {name}', table.names())}")
        unit = "rad" if joint.turns else "m"
        columns.append(table.column(title, gaps=True) * factor_to(unit, table.units.get(title, unit), title))
    holds = {name[6:]: table.column(name) > 0.5 for name in table.names() if name.startswith("holds ")}
    return Postures(np.column_stack(columns), holds)


def postures_of(given: Any, chain: ClosedChain, what: str) -> Postures:
    """Return the postures in `Postures`, a recording, an array of joint positions, or the file at a path.

    Raises:
        StateError: they have another number of joints than the chain, or name what it does not have.
    """
    if isinstance(given, str | PathLike):
        given = load_postures(given, chain)
    elif isinstance(given, Recording):
        given = Postures(given.q)
    elif not isinstance(given, Postures):
        given = Postures(given)
    count = sum(joint.type.position_count for joint in chain.all_joints)
    if given.q.shape[1] != count:
        raise StateError(f"{what}: q: expected {count} joint positions, got {given.q.shape[1]}")
    known = [*chain.grasps, *chain.as_forest.closures]
    for name in given.holds:
        if name not in known:
            raise StateError(
                f"{what}: holds: no grasp or loop {name!r}.{checks.did_you_mean(str(name), map(str, known))}"
            )
    return given
