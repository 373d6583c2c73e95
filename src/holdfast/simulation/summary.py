"""The summary of a run, with the numbers of the summary table."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast import outer
from holdfast.forces.margins import joint_coordinates
from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp_rows import grasp_rows
from holdfast.simulation.balance import MomentumBalance
from holdfast.simulation.events import Occurrence, ending
from holdfast.simulation.margins import JOINT_QUANTITIES, freedom_names
from holdfast.simulation.trajectory import LOWEST, Trajectory, part_of
from holdfast.spatial.scalar import Array


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
        momentum_imbalance: largest change of angular and linear momentum that no wrench explains [N m s, N s]; None if
            there is not a sample at every step, and for a chain with branches.
        momentum_moved: largest angular and linear momentum in the run, for comparison [N m s, N s]; None for a chain
            with branches.
        peak_force: largest grasp force, by arm that held the object; by grasp and loop of a chain with branches [N].
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
    momentum_imbalance: tuple[float, float] | None
    momentum_moved: tuple[float, float] | None
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
    attached = () if run.setting is None else run.setting.options.get("attached", ())
    return summary_of_parts(chain, [run], run.stopped, run.occurrences, attached)


def summary_of_parts(
    chain: ClosedChain,
    parts: Iterable[Trajectory],
    stopped: str | None,
    occurrences: tuple[Occurrence, ...],
    attached: Sequence[str] = (),
) -> Summary:
    """Return the summary of a run of the chain whose successive parts are given, one of which is in memory at a time.

    Args:
        chain: the chain.
        parts: the parts, at least one.
        stopped: the reason why the run ended early, or None.
        occurrences: the log.
        attached: names of grasps of a chain with branches that close later.

    Raises:
        StateError: an array was not recorded.
    """
    first: Trajectory | None = None  # the first sample
    run: Trajectory | None = None
    worst: dict[str, Any] = {}  # largest values
    lowest: dict[str, tuple[Array, ...]] = {}  # lowest values, and what belongs to them
    balance, samples, forest = MomentumBalance(), 0, bool(chain.beyond_serial)
    for run in parts:
        largest = _largest_values(run, run if first is None else first, first is None)
        first = part_of(run, slice(0, 1)) if first is None else first
        if run.every == 1 and not forest:
            unexplained = balance.add(run.t, run.momentum, run.momentum_rate, run.base_impulse)
            largest["unexplained"] = _halves(unexplained)
        worst |= {name: np.maximum(x, worst.get(name, x)) for name, x in largest.items()}
        for name, others in LOWEST.items():
            k = np.argmin(getattr(run, name), axis=0)[None]
            here = tuple(np.take_along_axis(getattr(run, of), k, axis=0)[0] for of in (name, *others))
            before = lowest.get(name, here)
            lowest[name] = tuple(np.where(here[0] < before[0], *pair) for pair in zip(here, before, strict=True))
        samples += len(run)
    assert run is not None
    every_step = run.every == 1 and not forest
    if every_step:
        worst["unexplained"] = np.maximum(worst["unexplained"], _halves(balance.rest()))
    joints = freedom_names(chain)
    names = [row.name for row in grasp_rows(chain, attached)]
    arms = [(i, name) for i, name in enumerate(names) if worst["holding"][i]]
    margins = [(name, *(float(x[i]) for x in lowest["lowest_margin"])) for i, name in arms]
    of_joints = zip(JOINT_QUANTITIES, *(x.tolist() for x in lowest["lowest_joint_margin"]), strict=True)
    best = -worst["loose_margin"] if "loose_margin" in worst else None
    return Summary(
        last_time=float(run.t[-1]),
        samples=samples,
        stopped=stopped,
        worst_position_gap=float(worst["position_gap"]),
        worst_velocity_gap=float(worst["velocity_gap"]),
        worst_step_drift=float(worst["drift"]),
        energy_imbalance=float(worst["imbalance"]),
        energy_moved=float(worst["energy"]),
        momentum_imbalance=_pair(worst["unexplained"]) if every_step else None,
        momentum_moved=None if forest else _pair(worst["momentum"]),
        peak_force={name: float(worst["force"][i]) for i, name in arms},
        peak_moment={name: float(worst["moment"][i]) for i, name in arms},
        peak_internal_force={} if forest else {name: float(worst["internal_force"][i]) for i, name in arms},
        spin={} if forest else {name: float(worst["turned"][i]) for i, name in arms if worst["spin"][i]},
        lowest_margin={name: (margin, when) for name, margin, when in margins if np.isfinite(margin)},
        lowest_best_margin={}
        if best is None
        else {name: float(best[i]) if np.isfinite(best[i]) else None for i, name in arms if worst["loose"][i]},
        lowest_joint_margin={
            what: (margin, joints[int(joint)], when) for what, margin, when, joint in of_joints if np.isfinite(margin)
        },
        worst_condition=float(worst["condition"]),
        torque_use=_torque_use(chain, worst["torque"]),
        limit_excess=_limit_excess(chain, worst["q"], -worst["-q"]),
        occurrences=occurrences,
    )


def _largest_values(run: Trajectory, start: Trajectory, begins: bool) -> dict[str, Any]:
    """Return the largest values in a part of a run by name; `start` has the first sample, which may begin the part."""
    moment, force = _halves(run.grasp_wrench)
    energy = run.kinetic + run.potential
    unexplained = energy - (start.kinetic[0] + start.potential[0]) - run.work.sum(axis=1) - run.impact
    moved = (run.kinetic, run.potential - start.potential[0], *run.work.T, run.impact)
    found = {
        "position_gap": run.position_gap[:, 1].max(),
        "velocity_gap": run.velocity_gap[:, 1].max(),
        "drift": run.position_gap[int(begins) :, 0].max(initial=0.0),
        "imbalance": np.abs(unexplained).max(),
        "energy": np.abs(moved).max(),
        "moment": moment,
        "force": force,
        "holding": run.holding.any(axis=0),
        "condition": run.condition.max(),
        "torque": np.abs(run.tau).max(axis=0),
        "q": run.q.max(axis=0),
        "-q": -run.q.min(axis=0),
    }
    if "internal_wrench" not in run.recorded:  # a chain that is answered as a forest
        return found
    loose = np.isinf(run.worst_margin) & (run.worst_margin < 0)
    return found | {
        "momentum": _halves(run.momentum),
        "internal_force": _halves(run.internal_wrench)[1],
        "turned": np.abs(run.spin - start.spin[0]).max(axis=0),
        "spin": (run.spin != 0.0).any(axis=0),
        "loose": loose.any(axis=0),
        "loose_margin": -np.where(loose, run.best_margin, np.inf).min(axis=0),
    }


def _halves(x: Array) -> Array:
    """Return the largest norms of the two halves of (samples, ..., 6), (2, ...); without samples 0."""
    return np.array([np.hypot.reduce(half, axis=-1).max(axis=0, initial=0.0) for half in (x[..., :3], x[..., 3:])])


def _pair(x: Array) -> tuple[float, float]:
    first, second = x.tolist()
    return first, second


def _torque_use(chain: ClosedChain, largest: Array) -> tuple[float, str] | None:
    limits = np.array([joint.effort_limit for joint in chain.freedoms])
    if not np.isfinite(limits).any():
        return None
    return _worst_joint(chain, largest / limits)


def _limit_excess(chain: ClosedChain, largest: Array, least: Array) -> tuple[float, str] | None:
    low, high = chain.position_limits.T
    largest, least = (joint_coordinates(chain, x) for x in (largest, least))
    beyond = np.maximum(low - least, largest - high)
    return _worst_joint(chain, beyond) if (beyond > 0).any() else None


def _worst_joint(chain: ClosedChain, x: Array) -> tuple[float, str]:
    """Return the largest entry of x (n,), and the name of its joint."""
    worst = int(np.argmax(x))
    return float(x[worst]), freedom_names(chain)[worst]
