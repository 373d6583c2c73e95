"""The choice between explicit and linearly implicit steps, made for each system by the criterion of `simulate`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from holdfast.model.closed_chain import ClosedChain
from holdfast.simulation.rollout.systems import RolloutSystems
from holdfast.simulation.runge_kutta import Tableau
from holdfast.simulation.stability import USED, cell, fastest_passive
from holdfast.spatial.scalar import Array
from holdfast.state import State

RATE, CELL = "passive_rate", "passive_cell"  # among a system's arrays, `systems.PASSIVE`: what was found, and where

# (systems, row) -> the chain, its grasps and bases those of one system, and its state
Located = Callable[[RolloutSystems, int], tuple[ClosedChain, State]]


def stiff_systems(systems: RolloutSystems, scheme: Tableau, stable_step: float, located: Located) -> Array:
    """Return which systems have dampers or springs too stiff for explicit steps of their length, (systems,).

    Args:
        systems: the systems, with their step lengths set.
        scheme: the scheme of explicit steps.
        stable_step: length of a step that is stable in every configuration at rest, where friction is steepest [s].
        located: returns the chain and the state of one system.
    """
    if scheme.implicit or systems.step_length.max() <= stable_step:
        return np.zeros(len(systems), dtype=bool)
    return systems.step_length * _rates(systems, located) > USED * scheme.stability_interval


def _rates(systems: RolloutSystems, located: Located) -> Array:
    """Return the fastest passive rate of each system [1/s], recomputed for systems whose joints have moved far."""
    cells, count = cell(systems.q), len(systems)
    known = systems.arrays.setdefault(CELL, np.full(cells.shape, np.nan))
    rates = systems.arrays.setdefault(RATE, np.zeros(count))
    for row in np.flatnonzero(systems.running & (known != cells).any(axis=1)).tolist():
        rates[row] = fastest_passive(*located(systems, row))[0].rate
        known[row] = cells[row]
    return rates
