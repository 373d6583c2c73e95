"""The summary of a run, with the numbers of the summary table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from holdfast import outer
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.balance import energy_moved
from holdfast.simulation.events import Occurrence, ending
from holdfast.simulation.margins import JOINT_QUANTITIES
from holdfast.spatial.scalar import Array

if TYPE_CHECKING:
    from holdfast.simulation.trajectory import Trajectory


@dataclass(frozen=True)
class Summary:
    """The main results of a run, as plain data.

    Attributes:
        last_time: time of the last sample [s].
        samples: number of samples.
        stopped: the reason why the run ended early, or None.
        worst_position_gap: largest position gap of any grasp after projection [m or rad].
        worst_velocity_gap: largest velocity gap of any grasp after projection [m/s or rad/s].
        worst_step_drift: largest position gap of any grasp before projection [m or rad].
        energy_imbalance: largest change of energy that no work explains [J].
        energy_moved: largest energy exchanged in the run, for comparison [J].
        momentum_imbalance: largest change of angular and linear momentum that no wrench explains [N m s, N s].
        momentum_moved: largest angular and linear momentum in the run, for comparison [N m s, N s].
        peak_force: largest grasp force, by arm that held the object [N].
        peak_moment: largest grasp moment, by arm that held the object [N m].
        peak_internal_force: largest internal part of the grasp force, by arm that held the object [N].
        spin: angle by which the contact of each soft finger has turned about its normal [rad].
        lowest_margin: lowest margin of each grasp that has limits, and its time [N, s].
        lowest_best_margin: for each grasp whose forces were not unique, the lowest value in the run of the largest
            margin that internal forces allow [N]; None if that margin is unbounded. (The smallest margin that they
            allow is unbounded.)
        lowest_joint_margin: for each limited quantity (position, rate, effort) the lowest margin, the joint, and the
            time [rad or m, rad/s or m/s, N m or N; s].
        worst_condition: largest condition number of the grasp constraint.
        torque_use: largest torque as a fraction of the effort limit, and the joint; None without limits.
        limit_excess: greatest excess over a position limit at a sample [rad or m], and the joint; None if every joint
            stayed within its limits.
        occurrences: the log: grasps that closed or opened, limits that were passed, and so on.
    """

    last_time: float
    samples: int
    stopped: str | None
    worst_position_gap: float
    worst_velocity_gap: float
    worst_step_drift: float
    energy_imbalance: float
    energy_moved: float
    momentum_imbalance: tuple[float, float]
    momentum_moved: tuple[float, float]
    peak_force: dict[str, float]
    peak_moment: dict[str, float]
    peak_internal_force: dict[str, float]
    spin: dict[str, float]
    lowest_margin: dict[str, tuple[float, float]]
    lowest_best_margin: dict[str, float | None]
    lowest_joint_margin: dict[str, tuple[float, str, float]]
    worst_condition: float
    torque_use: tuple[float, str] | None
    limit_excess: tuple[float, str] | None
    occurrences: tuple[Occurrence, ...]

    def __repr__(self) -> str:
        """Return how far the run got, the largest closure error and the peak forces."""
        peaks = "".join(f", {name} {force:.4g} N" for name, force in self.peak_force.items())
        end = ending(self.stopped, self.occurrences)
        parts = f"closure error {self.worst_position_gap:.1e}; peak forces{peaks[1:] or ' none'}"
        return f"<Summary: {self.samples} samples, to {self.last_time:g} s, {end}; {parts}>"

    def _repr_html_(self) -> str:
        """Return the table of `holdfast summary` for notebooks."""
        return outer.html_of_summary(self)


def summarise(chain: ClosedChain, run: Trajectory) -> Summary:
    """Return the summary of a run of the chain."""
    moment, force = _largest(run.grasp_wrench)
    internal = _largest(run.internal_wrench)[1]
    arms = [(i, name) for i, name in enumerate(chain.names) if run.holding[:, i].any()]
    return Summary(
        last_time=float(run.t[-1]),
        samples=len(run),
        stopped=run.stopped,
        worst_position_gap=float(run.position_gap[:, 1].max()),
        worst_velocity_gap=float(run.velocity_gap[:, 1].max()),
        worst_step_drift=float(run.position_gap[1:, 0].max(initial=0.0)),
        energy_imbalance=float(np.abs(run.imbalance).max()),
        energy_moved=energy_moved(run.kinetic, run.potential, run.work, run.impact),
        momentum_imbalance=_halves(run.momentum_imbalance),
        momentum_moved=_halves(run.momentum),
        peak_force={name: float(force[i]) for i, name in arms},
        peak_moment={name: float(moment[i]) for i, name in arms},
        peak_internal_force={name: float(internal[i]) for i, name in arms},
        spin={name: float(np.abs(run.spin[:, i] - run.spin[0, i]).max()) for i, name in arms if run.spin[:, i].any()},
        lowest_margin=_lowest_margins(run, arms),
        lowest_best_margin=_lowest_best_margins(run, arms),
        lowest_joint_margin=_lowest_joint_margins(run, chain.joint_names()),
        worst_condition=float(run.condition.max()),
        torque_use=_torque_use(chain, run.tau),
        limit_excess=_limit_excess(chain, run.q),
        occurrences=run.occurrences,
    )


def _largest(wrenches: Array) -> tuple[Array, Array]:
    """Return the largest norms of moment and force for every arm."""
    halves = wrenches[:, :, :3], wrenches[:, :, 3:]
    moment, force = (np.hypot.reduce(half, axis=2).max(axis=0) for half in halves)
    return moment, force


def _halves(momentum: Array) -> tuple[float, float]:
    """Return the largest norms of angular and linear momentum."""
    angular, linear = (float(np.hypot.reduce(half, axis=1).max()) for half in (momentum[:, :3], momentum[:, 3:]))
    return angular, linear


def _lowest_margins(run: Trajectory, arms: list[tuple[int, str]]) -> dict[str, tuple[float, float]]:
    k = np.argmin(run.lowest_margin, axis=0)
    found = {name: (float(run.lowest_margin[k[i], i]), float(run.lowest_margin_time[k[i], i])) for i, name in arms}
    return {name: lowest for name, lowest in found.items() if np.isfinite(lowest[0])}


def _lowest_best_margins(run: Trajectory, arms: list[tuple[int, str]]) -> dict[str, float | None]:
    loose = np.isinf(run.worst_margin) & (run.worst_margin < 0)
    lowest = np.where(loose, run.best_margin, np.inf).min(axis=0)
    return {name: float(lowest[i]) if np.isfinite(lowest[i]) else None for i, name in arms if loose[:, i].any()}


def _lowest_joint_margins(run: Trajectory, joints: list[str]) -> dict[str, tuple[float, str, float]]:
    found = {}
    for i, quantity in enumerate(JOINT_QUANTITIES):
        k = int(np.argmin(run.lowest_joint_margin[:, i]))
        margin, when = float(run.lowest_joint_margin[k, i]), float(run.lowest_joint_margin_time[k, i])
        if np.isfinite(margin):
            found[quantity] = margin, joints[int(run.lowest_joint[k, i])], when
    return found


def _torque_use(chain: ClosedChain, tau: Array) -> tuple[float, str] | None:
    limits = np.array([joint.effort_limit for joint in chain.all_joints])
    if not np.isfinite(limits).any():
        return None
    return _worst_joint(chain, np.abs(tau).max(axis=0) / limits)


def _limit_excess(chain: ClosedChain, q: Array) -> tuple[float, str] | None:
    low, high = np.array([joint.position_limits for joint in chain.all_joints]).reshape(-1, 2).T
    beyond = np.maximum(low - q, q - high).max(axis=0)
    return _worst_joint(chain, beyond) if (beyond > 0).any() else None


def _worst_joint(chain: ClosedChain, x: Array) -> tuple[float, str]:
    """Return the largest entry of x (n,), and the name of its joint."""
    worst = int(np.argmax(x))
    return float(x[worst]), chain.joint_names()[worst]
