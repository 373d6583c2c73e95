"""What happens in a run between its samples: grasps that close or open, limits that are passed, and so on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal["attach", "release", "violation", "recovery", "singular", "stiff"]


@dataclass(frozen=True)
class Occurrence:
    """One entry of a run's log, as plain data.

    Attributes:
        t: time [s].
        kind: "attach" or "release" of a grasp; "violation", when a margin becomes negative; "recovery", when it becomes
            positive again; "singular", when the grasp constraint loses rank; "stiff", when steps become linearly
            implicit because explicit steps could not follow the damping or springs.
        name: the arm, or 'arm/joint'; "grasps" for a singular configuration, "joints" for stiff joints.
        text: description of the occurrence.
        quantity: limited quantity of a violation or recovery: "grasp", "position", "rate" or "effort".
        lowest: for a recovery, the lowest margin since the violation [N; rad or m; rad/s or m/s; N m or N].
        lowest_time: time of that lowest margin [s].
        impulses: for an attach, (arms, 6) [moment; force] impulse of each arm on the object about its contact
            point, world axes [N m s, N s].
        base_impulses: for an attach, (arms, 6) impulse of the base on each arm about the base origin, world axes.
        trunk_base_impulse: for an attach, (6,) impulse of the base on a trunk about the base origin; empty without a
            trunk.
        energy_change: for an attach, the change of the kinetic energy [J].
        rank: for a singular configuration, the rank of the grasp constraint there.
        generic_rank: for a singular configuration, the rank of the constraint before and after.
        lost: for a singular configuration, in words, the loads that it cannot resist and the directions that arms lose.
    """

    t: float
    kind: Kind
    name: str
    text: str
    quantity: str | None = None
    lowest: float | None = None
    lowest_time: float | None = None
    impulses: tuple[tuple[float, ...], ...] = ()
    base_impulses: tuple[tuple[float, ...], ...] = ()
    trunk_base_impulse: tuple[float, ...] = ()
    energy_change: float = 0.0
    rank: int | None = None
    generic_rank: int | None = None
    lost: tuple[str, ...] = ()
