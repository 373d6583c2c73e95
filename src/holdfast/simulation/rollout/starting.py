"""How systems of a rollout start: on the grasps, by rows that suit them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from holdfast.compiled.externals import state_fields
from holdfast.compiled.statuses import MOST_TRIED, system
from holdfast.dynamics.rank import closed_near, held_near
from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.environment import Environment
from holdfast.simulation.rollout.arguments import kernel_arguments
from holdfast.simulation.rollout.systems import RolloutSystems
from holdfast.state import State

if TYPE_CHECKING:
    from holdfast.simulation.rollout.rollout import Rollout


def hold_rows(rollout: Rollout, systems: RolloutSystems, close: Callable[[RolloutSystems], None]) -> None:
    """Bring systems near the grasps by rows that suit one of them; each then chooses its own.

    Args:
        rollout: whose they are.
        systems: with nothing but states; changed in place.
        close: takes a step of length zero.
    """
    rank, begun = rollout.generic_rank, systems.copy()
    assert rank is not None
    near = closed_systems(rollout, systems)
    one = next((held for place in near if (held := held_near(*place, rank)) is not None), np.ones(6))
    systems.arrays["held_rows"] = np.ones((len(systems), *rollout.kernel.carried["held_rows"]))
    begun.arrays["held_rows"] = one * systems.arrays["held_rows"]
    close(begun)
    there = begun.running
    for name in (*state_fields(rollout.chain), "held_rows"):
        systems.arrays[name][there] = begun.arrays[name][there]


def closed_systems(rollout: Rollout, systems: RolloutSystems) -> Iterator[tuple[ClosedChain, State]]:
    """Yield chain and state, closed, of the first systems whose grasps nearly hold."""
    for row in np.flatnonzero(systems.running)[:MOST_TRIED].tolist():
        chain, state = located(rollout, systems, row)
        closed = closed_near(chain, state)
        if closed is not None:
            yield chain, closed


def located(rollout: Rollout, systems: RolloutSystems, row: int) -> tuple[ClosedChain, State]:
    """Return one system's chain, its bases where they are, and its state."""
    _, parameters = kernel_arguments(rollout.kernel, systems.call_inputs)
    at = {name: systems.arrays[name] for name in state_fields(rollout.chain)} | rollout.kernel.parameters | parameters
    chain, state = system(rollout.chain, at, row)
    return Environment(chain, rollout.base_motion).chain_at(float(systems.t[row])), state
