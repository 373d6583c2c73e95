"""A simulated run: what every sample holds, and all samples stacked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from holdfast.dynamics.energy import kinetic_energy, potential_energy
from holdfast.simulation.balance import imbalance
from holdfast.simulation.instant import Instant
from holdfast.simulation.step import Gaps
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
    "base_wrench": "[moment; force] of the base on each arm about the base origin, N m and N, world axes",
    "position_gap": "worst grasp before and after projection, m or rad",
    "velocity_gap": "worst grasp before and after projection, m/s or rad/s",
    "kinetic": "J",
    "potential": "J",
    "work": "work since the start of drives, damping and friction, bases, external wrenches, J",
    "condition": "1",
}


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A run sampled at every step; the first axis of every array is the sample.

    One sample alone has the same fields without that axis. `UNITS` gives units and axes.

    Attributes:
        t: (samples,) [s].
        q, qd, qdd, tau: (samples, n).
        object_pose: (samples, 7) wxyz_xyz.
        object_twist, object_acceleration: (samples, 6).
        grasp_wrench, base_wrench: (samples, arms, 6).
        position_gap, velocity_gap: (samples, 2) before and after projection.
        kinetic, potential: (samples,) [J].
        work: (samples, 4) since the start, see `balance.WORK_TERMS` [J].
        condition: (samples,) of the grasp constraint.
        stopped: None for a run that reached its end, else what ended it.
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
    base_wrench: Array
    position_gap: Array
    velocity_gap: Array
    kinetic: Array
    potential: Array
    work: Array
    condition: Array
    stopped: str | None = None

    def __len__(self) -> int:
        return len(self.t)

    def state(self, k: int) -> State:
        """Return the state of sample k."""
        return State(self.q[k], self.qd[k], self.object_pose[k], self.object_twist[k])

    @property
    def imbalance(self) -> Array:
        """(samples,) energy that no work accounts for [J]."""
        return imbalance(self.kinetic, self.potential, self.work)


def sample(at: Instant, gaps: Gaps, work: Array) -> Trajectory:
    """Return one sample: the fields of a trajectory without the sample axis."""
    state, found = at.state, at.result
    return Trajectory(
        t=np.array(at.t),
        q=state.q,
        qd=state.qd,
        qdd=found.qdd,
        tau=at.tau,
        object_pose=state.object_pose,
        object_twist=state.object_twist,
        object_acceleration=found.object_acceleration,
        grasp_wrench=found.grasp_wrench,
        base_wrench=found.base_wrench,
        position_gap=gaps.position,
        velocity_gap=gaps.velocity,
        kinetic=np.array(kinetic_energy(at.chain, state, at.inputs)),
        potential=np.array(potential_energy(at.chain, state)),
        work=work,
        condition=np.array(found.condition),
    )


def stacked(samples: Sequence[Trajectory], stopped: str | None = None) -> Trajectory:
    """Return single samples as one run."""
    return Trajectory(**{key: np.stack([getattr(s, key) for s in samples]) for key in array_names()}, stopped=stopped)


def array_names() -> list[str]:
    """Return the names of a trajectory's arrays."""
    return [f.name for f in fields(Trajectory) if f.name != "stopped"]
