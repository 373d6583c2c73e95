"""What happens at single instants of a run: grasps that close and open, limits that are passed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal["attach", "release", "violation", "recovery"]


@dataclass(frozen=True)
class Occurrence:
    """One line of a run's log; plain data.

    Attributes:
        t: when [s].
        kind: "attach" and "release" of a grasp; "violation", a margin that becomes negative, and
            "recovery", where it no longer is.
        name: the arm, or 'arm/joint'.
        text: what happened, in words.
        quantity: of a violation or recovery, what was passed: "grasp", "position", "rate", "effort".
        lowest: of a recovery, the lowest margin since the violation [N; rad or m; rad/s or m/s; N m or N].
        lowest_time: when that was [s].
        impulses: of an attach, (arms, 6) [moment; force] impulse of each arm on the object about its contact
            point, world axes [N m s, N s].
        base_impulses: of an attach, (arms, 6) of the base on each arm about the base origin.
        energy_change: of an attach, of the kinetic energy [J].
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
    energy_change: float = 0.0
