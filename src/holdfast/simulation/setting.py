"""The setting of a run: its chain, the motions of its bases, and the arguments of `simulate`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp_rows import GraspRow, grasp_rows
from holdfast.names import called
from holdfast.simulation.environment import BaseMotion, motion_of
from holdfast.spatial.frozen import Frozen, frozen_property
from holdfast.spatial.pose import Pose
from holdfast.spatial.scalar import Array


@dataclass(frozen=True, eq=False)
class RecordedBase(Frozen):
    """The recorded motion of a base. It can be called like the base motions of `simulate`, but only at sample times.

    Attributes:
        t: (samples,) [s].
        R: (samples, 3, 3) attitude in the world.
        p: (samples, 3) origin [m].
        twist: (samples, 6) [omega; v of the origin], world axes.
        acceleration: (samples, 6) [omega_dot; v_dot of the origin], world axes.
    """

    t: Array
    R: Array
    p: Array
    twist: Array
    acceleration: Array

    def __call__(self, t: float) -> tuple[Pose, Array, Array]:
        """Return the pose, twist and acceleration at the time of a sample.

        Raises:
            StateError: t is not the time of a sample.
        """
        k = int(np.searchsorted(self.t, t))
        if k == len(self.t) or self.t[k] != t:
            raise StateError(f"base motion: expected the time of a sample of the run, where it is recorded, got {t} s")
        return Pose.unchecked(self.R[k], self.p[k]), self.twist[k], self.acceleration[k]


def recorded_base(name: str, motion: BaseMotion, times: Array) -> RecordedBase:
    """Return the motion of a base at the times of samples; `motion` is called once per sample.

    Args:
        name: name of the arm, or "trunk", for messages.
        motion: base motion as for `simulate`.
        times: (samples,) [s].
    """
    moments = [motion_of(name, motion(t)) for t in times.tolist()]
    poses = [checks.pose(pose, f"base motion of '{name}'") for pose, _, _ in moments]
    R, p = np.array([pose.R for pose in poses]), np.array([pose.p for pose in poses])
    twist, acceleration = (np.array([moment[i] for moment in moments]) for i in (1, 2))
    return RecordedBase(times, R.reshape(-1, 3, 3), p.reshape(-1, 3), twist.reshape(-1, 6), acceleration.reshape(-1, 6))


@called
@dataclass(frozen=True, eq=False)
class Setting(Frozen):
    """The setting of a run.

    Attributes:
        chain: the chain at the start.
        base_motion: motions of the moving bases at the samples, by arm name, or "trunk".
        name: name of the run.
        duration: requested duration [s].
        step: requested step [s].
        options: other arguments of `simulate`, as plain data.
        controller: the controller of the scene; None for a run from Python, whose folder does not contain it.
    """

    chain: ClosedChain
    base_motion: Mapping[str, BaseMotion] = field(default_factory=dict)
    name: str = "run"
    duration: float = 0.0
    step: float = 0.0
    options: Mapping[str, Any] = field(default_factory=dict)
    controller: Any = None

    @frozen_property
    def rows(self) -> Sequence[GraspRow]:
        """What the rows of wrenches and margins of the run belong to; see `grasp_rows`."""
        return tuple(grasp_rows(self.chain, self.options.get("attached", ())))
