"""What is recorded of a chain that is answered as a forest, in the arrays of a `Trajectory`."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np

from holdfast.dynamics.tree.mechanism_terms import joint_rows
from holdfast.simulation.balance import Sums
from holdfast.simulation.events import Occurrence
from holdfast.simulation.mechanism_margins import MechanismSignals
from holdfast.simulation.mechanism_moment import MechanismMoment
from holdfast.simulation.sample import Samples, lowest_joints
from holdfast.simulation.step import Gaps
from holdfast.simulation.trajectory import Trajectory
from holdfast.spatial.scalar import Array

AS_RECORDED = ("q", "qd", "qdd", "object_pose", "object_twist", "object_acceleration", "condition")
OF_ACCOUNT = ("closure_wrench", "coupling_force", "kinetic", "potential")  # of a `ForestAccount`
OF_BASE = {f"floating_{name}": f"base_{name}" for name in ("pose", "twist", "acceleration")}


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
    of_rows = margins[-1:, : len(signals.rows)]
    allowed = of_rows, of_rows, of_rows
    one = Samples.of_one(at.t, _arrays(signals, at), allowed, gaps, sums.work, times, margins)
    found = {name: np.asarray(getattr(at.account, name))[None] for name in OF_ACCOUNT}
    return mechanism_recorded(signals, found, one, sums, names, occurrences)


def mechanism_recorded(
    signals: MechanismSignals,
    found: Mapping[str, Array],
    samples: Samples,
    sums: Sums,
    names: Collection[str],
    occurrences: tuple[Occurrence, ...] = (),
) -> Trajectory:
    """Return a run of the given samples; see `sample.recorded`.

    Args:
        signals: the signals of the chain.
        found: forces and energies (k, ...) by the names `OF_ACCOUNT`.
        samples: the samples, between which nothing has happened.
        sums: impulses since the run's start.
        names: the arrays to record.
        occurrences: what has happened since the previous sample.
    """
    x, k, rows = samples.arrays, len(samples.t), len(signals.rows)
    joint, least, joint_when = lowest_joints(samples.lowest[:, rows:], samples.lowest_time[:, rows:])
    arrays: dict[str, Any] = {name: x[name] for name in AS_RECORDED}
    arrays |= {field: x.get(name, np.zeros((k, 0))) for name, field in OF_BASE.items()}
    arrays |= {
        "t": samples.t,
        "tau": x["drive"],
        "grasp_wrench": signals.wrenches(found["closure_wrench"]),
        "coupling_force": found["coupling_force"],
        "holding": np.tile(signals.holding, (k, 1)),
        "kinetic": found["kinetic"],
        "potential": found["potential"],
        "impact": np.full(k, sums.impact),
        "work": samples.work,
        "position_gap": samples.gaps[:, ::2],
        "velocity_gap": samples.gaps[:, 1::2],
        "margin": samples.margins[0],
        "lowest_margin": samples.lowest[:, :rows],
        "lowest_margin_time": samples.lowest_time[:, :rows],
        "lowest_joint_margin": least,
        "lowest_joint_margin_time": joint_when,
        "lowest_joint": joint,
    }
    return Trajectory(**{name: arrays[name] for name in names if name in arrays}, occurrences=occurrences)


def _arrays(signals: MechanismSignals, at: MechanismMoment) -> dict[str, Array]:
    """Return the state, torques and accelerations of an instant by the names of machine code, as one sample."""
    state, qdd, joints = at.state, at.accelerations, joint_rows(signals.chain)
    of_objects = qdd[joints.stop :].reshape(np.shape(state.object_twist))
    found = {"q": state.q, "qd": state.qd, "qdd": qdd[joints], "drive": at.tau, "object_acceleration": of_objects}
    found |= {"object_pose": state.object_pose, "object_twist": state.object_twist}
    if state.base_pose is not None:
        assert state.base_twist is not None
        of_base = (state.base_pose, state.base_twist, qdd[: joints.start])
        found |= dict(zip(OF_BASE, of_base, strict=True))
    return {name: np.array(x)[None] for name, x in {**found, "condition": at.sample.now.condition}.items()}
