"""A simulated run: what every sample holds, and all samples stacked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from holdfast.errors import ModelError, StateError
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.balance import imbalance, momentum_imbalance
from holdfast.simulation.interpolation import Knot, interpolant
from holdfast.simulation.occurrence import Occurrence
from holdfast.spatial.frozen import Frozen
from holdfast.spatial.scalar import Array
from holdfast.state import State

UNITS = {
    "t": "s",
    "q": "rad or m",
    "qd": "rad/s or m/s",
    "qdd": "rad/s^2 or m/s^2",
    "tau": "N m or N",
    "object_pose": "unit quaternion wxyz, then m; world axes",
    "object_twist": "[omega; v of C], rad/s and m/s, world axes",
    "object_acceleration": "[omega_dot; v_dot of C], rad/s^2 and m/s^2, world axes",
    "grasp_wrench": "[moment; force] of each arm on the object about the contact point, N m and N, world axes",
    "internal_wrench": "the part of grasp_wrench that does not move the object",
    "load_share": "part of the net force that each arm carries, 1; all 0 where there is no net force",
    "wrist_wrench": "[moment; force] of each arm across its tip frame, about the tip's origin, N m and N, tip axes",
    "base_wrench": "[moment; force] of the base on each arm about the base origin, N m and N, world axes",
    "holding": "whether each arm has a grasp",
    "spin": "turn of each soft finger's contact about its normal, rad; 0 for other grasps",
    "margin": "how far each grasp is from giving way, N; infinite where nothing limits",
    "best_margin": "the largest margin that internal forces of no effect on the motion allow, N",
    "worst_margin": "the smallest, N; minus infinity where they have no bound",
    "lowest_margin": "the lowest margin of each grasp since the sample before, N",
    "lowest_margin_time": "when that was, s",
    "lowest_joint_margin": "the lowest margin of any joint since the sample before: position in rad or m, rate in"
    " rad/s or m/s, effort in N m or N; infinite where nothing limits",
    "lowest_joint_margin_time": "when that was, s",
    "lowest_joint": "which joint that was, by place in q",
    "position_gap": "worst grasp before and after projection, m or rad",
    "velocity_gap": "worst grasp before and after projection, m/s or rad/s",
    "kinetic": "J",
    "potential": "J",
    "work": "work since the start of drives, damping and friction, bases, external wrenches, J",
    "impact": "energy that impulses have added since the start, J",
    "momentum": "[angular; linear] of links and object about the world's origin, N m s and N s, world axes",
    "momentum_rate": "[moment; force] of bases, weights and external wrenches about the world's origin, N m and N",
    "base_impulse": "[angular; linear] impulses of the bases in impacts since the start, about the world's origin,"
    " N m s and N s",
    "condition": "1",
}


@dataclass(frozen=True, eq=False)
class Trajectory(Frozen):
    """A run sampled at every step; the first axis of every array is the sample.

    One sample alone has the same fields without that axis. `UNITS` gives units and axes. Times
    increase; where torques, inputs or grasps jump there are two samples, 1e-15 s or a unit in the last
    place apart.

    Attributes:
        t: (samples,) [s].
        q, qd, qdd, tau: (samples, n).
        object_pose: (samples, 7) wxyz_xyz.
        object_twist, object_acceleration: (samples, 6).
        grasp_wrench, internal_wrench, wrist_wrench, base_wrench: (samples, arms, 6).
        load_share, holding, spin: (samples, arms).
        margin, best_margin, worst_margin, lowest_margin, lowest_margin_time: (samples, arms).
        lowest_joint_margin, lowest_joint_margin_time, lowest_joint: (samples, 3), see
            `limits.JOINT_QUANTITIES`.
        position_gap, velocity_gap: (samples, 2) before and after projection.
        kinetic, potential, impact: (samples,) [J].
        work: (samples, 4) since the start, see `balance.WORK_TERMS` [J].
        momentum, momentum_rate, base_impulse: (samples, 6).
        condition: (samples,) of the grasp constraint.
        stopped: None for a run that reached its end, else what ended it.
        occurrences: grasps that closed and opened, limits that were passed, in order of time.
    """

    t: Array
    q: Array
    qd: Array
    qdd: Array
    tau: Array
    object_pose: Array
    object_twist: Array
    object_acceleration: Array
    grasp_wrench: Array
    internal_wrench: Array
    load_share: Array
    wrist_wrench: Array
    base_wrench: Array
    holding: Array
    spin: Array
    margin: Array
    best_margin: Array
    worst_margin: Array
    lowest_margin: Array
    lowest_margin_time: Array
    lowest_joint_margin: Array
    lowest_joint_margin_time: Array
    lowest_joint: Array
    position_gap: Array
    velocity_gap: Array
    kinetic: Array
    potential: Array
    work: Array
    impact: Array
    momentum: Array
    momentum_rate: Array
    base_impulse: Array
    condition: Array
    stopped: str | None = None
    occurrences: tuple[Occurrence, ...] = ()

    def __len__(self) -> int:
        return len(self.t)

    def state(self, k: int) -> State:
        """Return the state of sample k."""
        return State(self.q[k], self.qd[k], self.object_pose[k], self.object_twist[k])

    def state_at(self, t: float) -> State:
        """Return the state at any time of the run; between samples by quintics, see `interpolation.interpolant`.

        Where the grasps or velocities jump, the state after the jump.

        Args:
            t: time [s].

        Raises:
            StateError: a time before the first sample or after the last.
        """
        if not self.t[0] <= t <= self.t[-1]:
            raise StateError(f"run: t: expected {self.t[0]:.9g} to {self.t[-1]:.9g} s, got {t:.9g} s")
        k = int(np.searchsorted(self.t, t, side="right")) - 1
        return self.state(k) if self.t[k] == t else interpolant(self._knot(k), self._knot(k + 1))(t)

    def _knot(self, k: int) -> Knot:
        return Knot(float(self.t[k]), self.state(k), self.qdd[k], self.object_acceleration[k])

    @property
    def imbalance(self) -> Array:
        """(samples,) energy that no work accounts for [J]."""
        return imbalance(self.kinetic, self.potential, self.work, self.impact)

    @property
    def momentum_imbalance(self) -> Array:
        """(samples, 6) [angular; linear] momentum that no wrench accounts for [N m s, N s]."""
        return momentum_imbalance(self.t, self.momentum, self.momentum_rate, self.base_impulse)


def stacked(samples: Sequence[Trajectory], stopped: str | None = None) -> Trajectory:
    """Return single samples as one run."""
    arrays = {key: np.stack([getattr(s, key) for s in samples]) for key in array_names()}
    return Trajectory(**arrays, stopped=stopped, occurrences=tuple(one for s in samples for one in s.occurrences))


def require_run_of(chain: Any, run: Any) -> None:
    """Refuse what is no run of a chain, before its arrays are taken apart.

    Raises:
        ModelError: what is no chain.
        StateError: what is no run, one without samples, or one of other arms.
    """
    if not isinstance(chain, ClosedChain):
        raise ModelError(f"chain: expected a ClosedChain, got a {type(chain).__name__}")
    if not isinstance(run, Trajectory):
        inside = "; try its .trajectory" if hasattr(type(run), "trajectory") else ""
        raise StateError(f"run: expected a Trajectory, as simulate returns it, got a {type(run).__name__}{inside}")
    if not len(run):
        raise StateError("run: expected samples, got none")
    here, there = (chain.joint_count, len(chain.arms)), (run.q.shape[1], run.grasp_wrench.shape[1])
    if here != there:
        raise StateError(
            f"run: expected one of this chain, {here[0]} joints in {here[1]} arms, got {there[0]} in {there[1]}"
        )


def array_names() -> list[str]:
    """Return the names of a trajectory's arrays."""
    return [f.name for f in fields(Trajectory) if f.name not in ("stopped", "occurrences")]
