"""The record of a rollout: the arrays of many systems at many times."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from holdfast import outer
from holdfast.model import checks
from holdfast.names import called
from holdfast.simulation.rollout.systems import RolloutSystems, status_summary
from holdfast.simulation.trajectory import Trajectory
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array


@dataclass(frozen=True, eq=False)
class RolloutArguments(Frozen):
    """The arguments from which a record was made.

    Attributes:
        rollout: the `Rollout`.
        systems: the systems at the start.
        step: step h [s].
        every: number of steps between two records.
        options: options of `Rollout.step`.
        duration: requested duration [s].
    """

    rollout: Any
    systems: RolloutSystems
    step: float
    every: int
    options: Mapping[str, Any]
    duration: float


@called
@dataclass(frozen=True, eq=False)
class RolloutRecord(Frozen):
    """The recorded arrays of a rollout; the first axis of every array is the time, the second the system.

    Attributes:
        t: (records,) [s].
        arrays: the recorded arrays by name, (records, systems, ...); a stopped system keeps its last good state. Of a
            record in a folder they are read when they are first used.
        systems: the systems at the end.
        stopped: (systems,) time at which each system stopped [s], infinite if it did not; the time of a slip is refined
            within its step.
        arguments: the arguments of the rollout; None for a record that was assembled from arrays.
        note: what is missing, in words; empty for a complete record.
    """

    t: Array
    arrays: Mapping[str, Array]
    systems: RolloutSystems
    stopped: Array
    arguments: RolloutArguments | None = None
    note: str = ""

    def __repr__(self) -> str:
        """Return the number of systems, the recorded times and arrays, and the status of the systems, on one line."""
        span = f"{self.t[0]:g} to {self.t[-1]:g} s" if len(self.t) else "no time"
        what = f"{len(self.systems)} systems at {len(self.t)} times, {span}: {', '.join(self.arrays)}"
        return f"<RolloutRecord of {what}; {'; '.join(filter(None, (status_summary(self.systems), self.note)))}>"

    def trajectory(self, system: int, every: int | None = None) -> Trajectory:
        """Return one system as a run, with everything that `simulate` records and all methods of a run.

        The steps are repeated with identical bits; the samples are at the recorded times, or closer together. Margins
        are evaluated at the samples only. The run of a system that stopped ends there, and `stopped` gives the reason.

        Args:
            system: number of the system, from 0.
            every: number of steps between two samples; by default as recorded.

        Raises:
            StateError: there is no such system, the record was assembled from arrays, or the first state of the system
                is invalid.
        """
        from holdfast.simulation.rollout.replay import replayed_run

        return replayed_run(self, system, every)

    def parts(self) -> Iterator[RolloutRecord]:
        """Yield the record piece by piece in the order of time, for records larger than memory.

        A record in a folder has the pieces in which it was written, of which one at a time is in memory; another record
        has one. Systems and `stopped` of each are those of the whole record.

        Raises:
            ResultError: the folder has changed since it was opened.
        """
        return outer.parts_of_record(self)

    def save(self, folder: str | PathLike[str], overwrite: bool = False) -> Path:
        """Write the record as a folder, which `holdfast.io.load_record` reads, and return the folder.

        Args:
            folder: the folder to write; it is created if it does not exist.
            overwrite: replace an earlier record in this folder; it is kept until the new one is complete.

        Raises:
            ResultError: the folder is in use or cannot be written.
        """
        return outer.save_record(self, folder, overwrite)

    def to_pandas(self) -> Any:
        """Return the record as a pandas DataFrame with one row per system and time, which form its index.

        Raises:
            MissingExtra: pandas is not installed.
        """
        return outer.frame_of_record(self)

    def to_xarray(self) -> Any:
        """Return the record as an xarray Dataset: arrays over `t` and `system`, with joints and arms by name.

        Raises:
            MissingExtra: xarray is not installed.
        """
        return outer.data_set_of_record(self)

    def __getitem__(self, name: str) -> Array:
        """Return a recorded array."""
        if name not in self.arrays:
            raise KeyError(f"'{name}' was not recorded.{checks.did_you_mean(name, self.arrays)}")
        return self.arrays[name]
