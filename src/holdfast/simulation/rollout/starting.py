"""The start of a rollout: systems are created, and the constraint rows for their projection are chosen."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np

from holdfast.compiled import arrays
from holdfast.compiled.arrays import invalid_mask, largest_positions
from holdfast.compiled.statuses import MOST_TRIED, system
from holdfast.compiler.schedule import External
from holdfast.control.controller import ControlLaw
from holdfast.control.sampled import SampledTorque, initial_memories
from holdfast.dynamics.rank import closed_near, constraint_rank, generic_rank_near, held_near
from holdfast.dynamics.tree.forest_simulate import ForestReference
from holdfast.dynamics.tree.mechanism_terms import flat_state
from holdfast.dynamics.tree.varied_forest import ForestArguments
from holdfast.errors import ClosureError, SingularChainError, StateError
from holdfast.forces.margins import quaternion_entries
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import state_fields
from holdfast.simulation.environment import Environment
from holdfast.simulation.rollout.arguments import fitting, kernel_arguments
from holdfast.simulation.rollout.systems import RolloutSystems
from holdfast.simulation.rollout.traced_step import BROKEN
from holdfast.spatial.real_numbers import ROTATION_TOLERANCE
from holdfast.spatial.scalar import Array
from holdfast.state import State

if TYPE_CHECKING:
    from holdfast.simulation.rollout.rollout import Rollout


def systems_at(rollout: Rollout, given: Mapping[str, Any], memory: Any, t: float) -> RolloutSystems:
    """Return systems at the states given by the user, not projected yet; invalid states are marked by their status.

    Raises:
        StateError: a shape is wrong, or there are no systems.
    """
    shapes = {name: rollout.kernel.carried[name] for name in given}
    state = {name: arrays.floats(name, x, shapes[name]) for name, x in given.items()}
    count = arrays.batch_of(state, {name: External(shape, "input") for name, shape in shapes.items()})
    if count == 0:
        raise StateError("rollout: expected at least one system, got arrays without rows")
    count = count or 1
    bad = invalid_mask(state, {name: len(s) for name, s in shapes.items()}, largest_positions(rollout.chain), count)
    memory = initial_memories(rollout.law, range(count)) if memory is None else memory
    found = rollout.kernel.systems(state, fitting("memory", memory, (len(rollout.law.memory),), count), count)
    bad = np.zeros(count, dtype=bool) if bad is None else bad
    for pose in (found[name] for name in given if name.endswith("pose")):
        pose[~bad, ..., :4] /= np.linalg.norm(pose[~bad, ..., :4], axis=-1, keepdims=True)
    for part in np.flatnonzero(quaternion_entries(rollout.chain)).reshape(-1, 4):
        length = np.linalg.norm(found["q"][:, part], axis=1, keepdims=True)
        bad |= ~(np.abs(length[:, 0] - 1.0) <= ROTATION_TOLERANCE)
        found["q"][np.ix_(~bad, part)] /= length[~bad]
    found["code"][bad] = BROKEN
    return RolloutSystems(rollout.chain, found, np.full(count, t), np.zeros(count))


def serial_rank(rollout: Rollout, systems: RolloutSystems) -> int | None:
    """Return the rank of the constraint near the first system that satisfies the grasps; None if none does."""
    near = next(closed_systems(rollout, systems), None)
    return None if near is None else generic_rank_near(*near, constraint_rank(*near))


def mechanism_rank(rollout: Rollout, systems: RolloutSystems) -> int | None:
    """Return the rank of the constraint of the first system that can be closed, as in `simulate`; None if none can."""
    forest = rollout.chain.as_forest.forest
    engine, none = ForestReference(forest), np.zeros((len(forest.bodies), 6))
    for row in np.flatnonzero(systems.running)[:MOST_TRIED].tolist():
        with suppress(ClosureError, SingularChainError, StateError):
            q, qd, _ = engine.closed(*flat_state(rollout.chain, systems.state(row)))
            return engine.instant(ForestArguments(forest, q, qd, 0.0 * qd, none)).rank
    return None


def remembered(law: ControlLaw, before: RolloutSystems) -> Array | None:
    """Return the memory with which a law takes over systems, None if theirs does not fit; a sample is taken again."""
    memory = before.arrays.get("before" if isinstance(law.torque, SampledTorque) else "memory")
    return None if memory is None or memory.shape[1] != len(law.memory) else memory


def hold_rows(rollout: Rollout, systems: RolloutSystems, close: Callable[[RolloutSystems], None]) -> None:
    """Project systems onto the grasps with constraint rows that suit one of them, and let each then choose its own.

    Args:
        rollout: the rollout of the systems.
        systems: systems of which only the states are set; changed in place.
        close: takes a step of length zero.
    """
    rank, trial = rollout.generic_rank, systems.copy()
    assert rank is not None
    near = closed_systems(rollout, systems)
    one = next((held for place in near if (held := held_near(*place, rank)) is not None), np.ones(6))
    systems.arrays["held_rows"] = np.ones((len(systems), *rollout.kernel.carried["held_rows"]))
    trial.arrays["held_rows"] = one * systems.arrays["held_rows"]
    close(trial)
    there = trial.running
    for name in (*state_fields(rollout.chain), "held_rows"):
        systems.arrays[name][there] = trial.arrays[name][there]


def closed_systems(rollout: Rollout, systems: RolloutSystems) -> Iterator[tuple[ClosedChain, State]]:
    """Yield the chain and the projected state of the first systems whose grasps are nearly satisfied."""
    for row in np.flatnonzero(systems.running)[:MOST_TRIED].tolist():
        chain, state = located(rollout, systems, row)
        closed = closed_near(chain, state)
        if closed is not None:
            yield chain, closed


def located(rollout: Rollout, systems: RolloutSystems, row: int) -> tuple[ClosedChain, State]:
    """Return the chain of one system, with its bases at their current poses, and its state."""
    _, parameters = kernel_arguments(rollout.kernel, systems.call_inputs)
    at = {name: systems.arrays[name] for name in state_fields(rollout.chain)} | rollout.kernel.parameters | parameters
    chain, state = system(rollout.chain, at, row)
    return Environment(chain, rollout.base_motion).chain_at(float(systems.t[row])), state
