"""The samples of a rollout of a chain that is answered as a forest, evaluated as those of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from holdfast.model.closed_chain import ClosedChain
from holdfast.model.grasp_rows import grasp_rows
from holdfast.questions.arrays import state_of
from holdfast.simulation.adaptive import Tolerance
from holdfast.simulation.balance import Sums
from holdfast.simulation.environment import Environment
from holdfast.simulation.mechanism_margins import MechanismSignals
from holdfast.simulation.mechanism_sample import mechanism_sample
from holdfast.simulation.rollout.mechanism_steppers import MechanismSteppers
from holdfast.simulation.rollout.record import with_own_bodies
from holdfast.simulation.rollout.systems import RolloutSystems
from holdfast.simulation.runge_kutta import scheme
from holdfast.simulation.step import Gaps
from holdfast.simulation.trajectory import Trajectory, array_names, joined
from holdfast.spatial.scalar import Array


def mechanism_chain(rollout: Any, systems: RolloutSystems, parameters: Mapping[str, Array]) -> ClosedChain:
    """Return the chain of one system, with its parameters."""
    return with_own_bodies(rollout.chain, rollout.kernel.parameters | parameters)


def mechanism_samples(
    world: Environment,
    rollout: Any,
    last: RolloutSystems,
    rows: Sequence[Mapping[str, Array]],
    before_jumps: Sequence[Mapping[str, Array]],
) -> list[Trajectory]:
    """Return the run of one system as `serial_samples` does; forces are the smallest, as in `simulate`."""
    chain, drive = world.chain, np.zeros(world.chain.joint_count)

    def driven(t: float, state: Any, memory: Any) -> tuple[Array, Any]:
        return drive, memory

    rank = -1 if rollout.generic_rank is None else rollout.generic_rank
    stepper = MechanismSteppers(len(rows))(world, driven, rank, scheme(rollout.scheme), Tolerance())
    signals, samples = MechanismSignals(chain, grasp_rows(chain)), []
    for row in (*rows, *before_jumps):
        t, drive = float(row["t"][0]), row["drive"][0]
        now = stepper.evaluate(t, state_of(row, 0), None)
        gaps, sums = Gaps(*row["gaps"][0].reshape(2, 2).T), Sums(row["work"][0], 0.0, np.zeros(6))
        samples.append(mechanism_sample(signals, now, gaps, sums, np.array([t]), signals.of_each([now]), array_names()))
    return [joined(samples)]
