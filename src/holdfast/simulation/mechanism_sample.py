"""What is recorded of a chain that is answered as a forest, in the arrays of a `Trajectory`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from holdfast.dynamics.tree.forest_simulate import ForestAccount, ForestSample
from holdfast.dynamics.tree.mechanism_terms import chain_state, joint_rows
from holdfast.simulation.events import Occurrence
from holdfast.simulation.mechanism_margins import MechanismInstant, MechanismSignals
from holdfast.simulation.run_record import Listeners, RecordSettings
from holdfast.simulation.sample import lowest_joints
from holdfast.simulation.trajectory import Trajectory, part_of
from holdfast.spatial.scalar import Array


def mechanism_instant(signals: MechanismSignals, sample: ForestSample, found: ForestAccount, tau: Array) -> Any:
    """Return the state, torques and wrenches of a sample, on which margins depend."""
    chain, wrench = signals.chain, np.zeros((len(signals.rows), 6))
    for i, row in signals.closed.items():
        wrench[i] = found.closure_wrench[chain.as_forest.closures[row.key]]
    return MechanismInstant(chain_state(chain, sample.given.q, sample.given.qd), tau, wrench)


def arrays_of(
    signals: MechanismSignals, sample: ForestSample, found: ForestAccount, at: MechanismInstant, impact: float
) -> dict[str, Any]:
    """Return the arrays of a sample by name, without those of margins.

    Args:
        signals: rows of the run, and the chain.
        sample: the forest at the end of a step.
        found: its forces, gaps and energies.
        at: the result of `mechanism_instant`.
        impact: energy that impulses have added since the start [J].
    """
    chain, state, none = signals.chain, at.state, np.zeros(0)
    qdd, joints, several = sample.now.qdd, joint_rows(chain), np.shape(state.object_twist)
    before, after = sample.drift, (found.position_gap, found.velocity_gap)
    return {
        "t": sample.t,
        "q": state.q,
        "qd": state.qd,
        "qdd": qdd[joints],
        "tau": at.tau,
        "object_pose": state.object_pose,
        "object_twist": state.object_twist,
        "object_acceleration": qdd[joints.stop :].reshape(several),
        "base_pose": none if state.base_pose is None else state.base_pose,
        "base_twist": none if state.base_twist is None else state.base_twist,
        "base_acceleration": qdd[: joints.start],
        "grasp_wrench": at.wrench,
        "coupling_force": found.coupling_force,
        "holding": np.isin(np.arange(len(signals.rows)), [*signals.closed]),
        "position_gap": np.array([before[0], after[0]]),
        "velocity_gap": np.array([before[1], after[1]]),
        "kinetic": found.kinetic,
        "potential": found.potential,
        "work": sample.work,
        "impact": impact,
        "condition": sample.now.condition,
    }


class MechanismRecord:
    """The samples that a run records: every so many steps, on both sides of a jump, and the last one."""

    def __init__(self, how: RecordSettings, signals: MechanismSignals, listeners: Listeners) -> None:
        self._how, self._count, self._listeners = how, len(signals.rows), listeners
        self._kept: list[dict[str, Any]] = []
        self._happened: list[Occurrence] = []
        self._waiting: tuple[dict[str, Any], Array] | None = None  # the last sample, if it is not recorded
        self._lowest, self._when = np.full(len(signals), np.inf), np.zeros(len(signals))

    def add(
        self,
        arrays: dict[str, Any],
        times: Sequence[float],
        margins: Sequence[Array],
        due: bool,
        happened: Sequence[Occurrence],
        begins: bool,
    ) -> None:
        """Take a sample.

        Args:
            arrays: the result of `arrays_of`.
            times: times since the sample before at which margins were evaluated; the last is that of this sample.
            margins: (signals,) at each of them.
            due: whether it is recorded, if it is not the last one.
            happened: what has happened since the sample before.
            begins: whether a smooth stretch begins with this sample.
        """
        if begins:
            self._lowest = np.full_like(self._lowest, np.inf)
        for t, found in zip(times, margins, strict=True):
            lower = found < self._lowest
            self._lowest, self._when = np.where(lower, found, self._lowest), np.where(lower, t, self._when)
        self._waiting = arrays, margins[-1]
        if due or happened:
            self._keep(happened)

    def _keep(self, happened: Sequence[Occurrence]) -> None:
        """Record the waiting sample with the lowest margins since the one before."""
        assert self._waiting is not None
        (arrays, now), rows = self._waiting, self._count
        t, lowest = arrays["t"], self._lowest[:rows]
        joint, (least,), (when,) = lowest_joints(self._lowest[None, rows:], self._when[None, rows:])
        one = arrays | {
            "margin": now[:rows],
            "lowest_margin": lowest,
            "lowest_margin_time": np.where(np.isfinite(lowest), self._when[:rows], t),
            "lowest_joint_margin": least,
            "lowest_joint_margin_time": np.where(np.isfinite(least), when, t),
            "lowest_joint": joint[0],
        }
        self._kept.append(one)
        self._happened += happened
        self._waiting, self._lowest, self._when = None, now, np.full_like(now, t)
        told = self._listeners
        if told.on_sample or told.on_samples:
            part = self._run([one], happened)
            if told.on_sample is not None:
                told.on_sample(part_of(part, 0, part.occurrences))
            for listen in told.on_samples:
                listen(part, None)

    def _run(self, samples: Sequence[dict[str, Any]], happened: Sequence[Occurrence]) -> Trajectory:
        """Return samples as a run."""
        names = [name for name in self._how.names if name in samples[0]]
        arrays: dict[str, Any] = {name: np.array([one[name] for one in samples]) for name in names}
        return Trajectory(**arrays, every=self._how.every, occurrences=tuple(happened))

    def run(self) -> Trajectory:
        """Return all recorded samples."""
        if self._waiting is not None:
            self._keep(())
        return self._run(self._kept, self._happened)
