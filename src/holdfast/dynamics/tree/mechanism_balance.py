"""Energies, momentum and power of chains that are answered as forests."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.power_terms import Power
from holdfast.dynamics.tree.forest_balance import ForestBalance, balance_of, base_power, momentum_rate
from holdfast.dynamics.tree.forest_dynamics import ForestResult
from holdfast.dynamics.tree.mechanism import MechanismResult
from holdfast.dynamics.tree.mechanism_terms import mechanism_arguments
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State


def mechanism_balance(
    chain: ClosedChain, state: State, inputs: Inputs | None = None, about: ArrayLike | None = None
) -> ForestBalance:
    """Return energies and momentum of all bodies of a chain; see `kinetic_energy` and `momentum`. O(n)."""
    return balance_of(mechanism_arguments(chain, state, inputs=inputs), about)


def mechanism_power(chain: ClosedChain, state: State, tau: ArrayLike, result: Any, inputs: Inputs | None) -> Power:
    """Return the power into a chain; see `power`. O(n)."""
    given, found = mechanism_arguments(chain, state, tau, inputs), _forces(chain, result)
    power = balance_of(given, None).power
    base = base_power(given, found.acceleration, found.closure_wrench)
    return power._replace(base=float(checks.finite(np.array(base), "power of the bases")))


def mechanism_momentum_rate(
    chain: ClosedChain, state: State, result: Any, about: ArrayLike | None, inputs: Inputs | None
) -> Array:
    """Return the rate of the momentum of all bodies of a chain, from their accelerations; see `momentum_rate`. O(n)."""
    given, found = mechanism_arguments(chain, state, inputs=inputs), _forces(chain, result)
    point = np.zeros(3) if about is None else checks.numbers(about, (3,), "about", StateError)
    return checks.finite(momentum_rate(given.motion({}), found.acceleration, point), "momentum rate")


def _forces(chain: ClosedChain, result: Any) -> ForestResult:
    """Return a result by bodies.

    Raises:
        StateError: it is no `MechanismResult`, or that of another chain.
    """
    checks.instance(result, MechanismResult, "result", StateError)
    found, forest = result.bodies, chain.as_forest.forest
    checks.numbers(found.acceleration, (len(forest.bodies), 6), "result: accelerations of the bodies", StateError)
    checks.numbers(found.closure_wrench, (len(forest.closures), 6), "result: grasp_wrench", StateError)
    return found
