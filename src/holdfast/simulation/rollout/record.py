"""What a rollout is recorded as."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from holdfast.model import checks
from holdfast.simulation.rollout.systems import RolloutSystems
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array


@dataclass(frozen=True, eq=False)
class RolloutRecord(Frozen):
    """Systems at the recorded times; the first axis of every array is the time, the second the system.

    Attributes:
        t: (records,) [s].
        arrays: what was asked for, by name, (records, systems, ...); of a system that stands still,
            its last good state.
        systems: at the end.
        stopped: (systems,) when each stopped [s], infinite if it did not; the instant of a slip
            is refined within its step.
    """

    t: Array
    arrays: Mapping[str, Array]
    systems: RolloutSystems
    stopped: Array

    def __getitem__(self, name: str) -> Array:
        """Return a recorded array."""
        if name not in self.arrays:
            raise KeyError(f"'{name}' was not recorded.{checks.did_you_mean(name, self.arrays)}")
        return self.arrays[name]
