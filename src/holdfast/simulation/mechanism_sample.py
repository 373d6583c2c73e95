"""What is recorded of a chain that is answered as a forest, in the arrays of a `Trajectory`."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np

from holdfast.dynamics.tree.mechanism_terms import joint_rows
from holdfast.simulation.balance import Sums
from holdfast.simulation.events import Occurrence
from holdfast.simulation.mechanism_margins import MechanismSignals
from holdfast.simulation.mechanism_moment import MechanismMoment
from holdfast.simulation.sample import lowest_joints, lowest_of
from holdfast.simulation.step import Gaps
from holdfast.simulation.trajectory import Trajectory
from holdfast.spatial.scalar import Array


def mechanism_sample(
    signals: MechanismSignals,
    at: MechanismMoment,
    gaps: Gaps,
    sums: Sums,
    times: Array,
    margins: Array,
    names: Collection[str],
    occurrences: tuple[Occurrence, ...] = (),
) -> Trajectory:
    """Return a run of one sample; arguments as for `sample.sample`, with the signals of the chain at that time."""
    arrays, rows = _arrays(signals, at) | {"impact": sums.impact, "work": sums.work}, len(signals.rows)
    lowest, when = lowest_of(times[None], margins[None])
    joint, least, joint_when = lowest_joints(lowest[:, rows:], when[:, rows:])
    arrays |= {
        "position_gap": gaps.position,
        "velocity_gap": gaps.velocity,
        "margin": margins[-1, :rows],
        "lowest_margin": lowest[0, :rows],
        "lowest_margin_time": when[0, :rows],
        "lowest_joint_margin": least[0],
        "lowest_joint_margin_time": joint_when[0],
        "lowest_joint": joint[0],
    }
    found: dict[str, Any] = {name: np.array(x)[None] for name, x in arrays.items() if name in names}
    return Trajectory(**found, occurrences=occurrences)


def _arrays(signals: MechanismSignals, at: MechanismMoment) -> dict[str, Any]:
    """Return the state, accelerations, forces and energies of a sample by name."""
    chain, state, found, none = signals.chain, at.state, at.account, np.zeros(0)
    qdd, joints, several = at.accelerations, joint_rows(chain), np.shape(state.object_twist)
    return {
        "t": at.t,
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
        "grasp_wrench": signals.wrenches(at),
        "coupling_force": found.coupling_force,
        "holding": signals.holding,
        "kinetic": found.kinetic,
        "potential": found.potential,
        "condition": at.sample.now.condition,
    }
