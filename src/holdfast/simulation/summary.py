"""What a run comes down to: the numbers of the summary table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.balance import energy_moved
from holdfast.simulation.trajectory import Trajectory
from holdfast.spatial.scalar import Array


@dataclass(frozen=True)
class Summary:
    """The numbers of one run; plain data.

    Attributes:
        last_time: of the last sample [s].
        samples: their number.
        stopped: what ended the run early, or None.
        worst_position_gap: of any grasp, after projection [m or rad].
        worst_velocity_gap: of any grasp, after projection [m/s or rad/s].
        worst_step_drift: position gap that a step left for projection to close [m or rad].
        energy_imbalance: largest energy that no work accounts for [J].
        energy_moved: largest energy that the run moved about, to compare with [J].
        peak_force: per arm with a grasp, largest grasp force [N].
        peak_moment: per arm with a grasp, largest grasp moment [N m].
        worst_condition: of the grasp constraint.
        torque_use: largest share of an effort limit, and the joint (None without limits).
        limit_excess: furthest beyond a position limit [rad or m], and the joint; None if
            every joint stayed within its limits.
    """

    last_time: float
    samples: int
    stopped: str | None
    worst_position_gap: float
    worst_velocity_gap: float
    worst_step_drift: float
    energy_imbalance: float
    energy_moved: float
    peak_force: dict[str, float]
    peak_moment: dict[str, float]
    worst_condition: float
    torque_use: tuple[float, str] | None
    limit_excess: tuple[float, str] | None


def summarise(chain: ClosedChain, run: Trajectory) -> Summary:
    """Return the summary of a run of the chain."""
    moment, force = (np.linalg.norm(run.grasp_wrench[:, :, part], axis=2).max(axis=0) for part in _HALVES)
    rows = {name: chain.names.index(name) for name in chain.grasps}
    return Summary(
        last_time=float(run.t[-1]),
        samples=len(run),
        stopped=run.stopped,
        worst_position_gap=float(run.position_gap[:, 1].max()),
        worst_velocity_gap=float(run.velocity_gap[:, 1].max()),
        worst_step_drift=float(run.position_gap[1:, 0].max(initial=0.0)),
        energy_imbalance=float(np.abs(run.imbalance).max()),
        energy_moved=energy_moved(run.kinetic, run.potential, run.work),
        peak_force={name: float(force[i]) for name, i in rows.items()},
        peak_moment={name: float(moment[i]) for name, i in rows.items()},
        worst_condition=float(run.condition.max()),
        torque_use=_torque_use(chain, run.tau),
        limit_excess=_limit_excess(chain, run.q),
    )


_HALVES = (slice(0, 3), slice(3, 6))


def _torque_use(chain: ClosedChain, tau: Array) -> tuple[float, str] | None:
    limits = np.array([joint.effort_limit for arm in chain.arms.values() for joint in arm.joints])
    used = np.abs(tau).max(axis=0) / limits
    worst = int(np.argmax(used))
    return (float(used[worst]), chain.joint_names()[worst]) if np.isfinite(limits).any() else None


def _limit_excess(chain: ClosedChain, q: Array) -> tuple[float, str] | None:
    low, high = np.concatenate([arm.position_limits for arm in chain.arms.values()]).T
    beyond = np.maximum(low - q, q - high).max(axis=0)
    worst = int(np.argmax(beyond))
    return (float(beyond[worst]), chain.joint_names()[worst]) if beyond[worst] > 0 else None
