"""Which systems of a rollout take linearly implicit steps: each decided by itself, as `simulate` decides."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.rollout.systems import RolloutSystems
from holdfast.simulation.runge_kutta import Tableau
from holdfast.simulation.stability import USED, cell, fastest_passive, may_be_too_fast
from holdfast.spatial.scalar import Array
from holdfast.state import State

RATE, CELL = "passive_rate", "passive_cell"  # among a system's arrays, `systems.PASSIVE`: what was found, and where

# (systems, row) -> the chain, its grasps and bases those of one system, and its state
Located = Callable[[RolloutSystems, int], tuple[ClosedChain, State]]


def stiff_systems(systems: RolloutSystems, scheme: Tableau, located: Located) -> Array:
    """Return which systems settle or swing too fast for explicit steps of their length, (systems,).

    Args:
        systems: with their step lengths set.
        scheme: of explicit steps.
        located: returns one of them.
    """
    longest, none = float(systems.step_length.max()), np.zeros(len(systems), dtype=bool)
    at_rest = np.zeros(systems.chain.joint_count)  # where friction is steepest
    if scheme.implicit or not may_be_too_fast(systems.chain, at_rest, longest, scheme):
        return none
    return systems.step_length * _rates(systems, located) > USED * scheme.stability_interval


def _rates(systems: RolloutSystems, located: Located) -> Array:
    """Return how fast each settles or swings [1/s], found anew where its joints have moved far."""
    cells, count = cell(systems.q), len(systems)
    known = systems.arrays.setdefault(CELL, np.full(cells.shape, np.nan))
    rates = systems.arrays.setdefault(RATE, np.zeros(count))
    for row in np.flatnonzero(systems.running & (known != cells).any(axis=1)).tolist():
        rates[row] = fastest_passive(*located(systems, row))[0].rate
        known[row] = cells[row]
    return rates
