"""Derivatives of the forward dynamics of chains that are answered as forests, by those of their forests."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.tree.forest_derivatives import ForestPoint, backward, forest_point, forward
from holdfast.dynamics.tree.mechanism import MechanismResult, mechanism_result
from holdfast.dynamics.tree.mechanism_terms import ForestPlace, chain_arguments, chain_results, mechanism_arguments
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.derivatives import Derivatives, directions, finite_derivatives, require_names
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State


def mechanism_vjp(
    chain: ClosedChain,
    state: State,
    tau: ArrayLike,
    inputs: Inputs | None,
    by: Sequence[str],
    check: bool,
    cotangents: Mapping[str, ArrayLike],
) -> Derivatives:
    """Return gradients by a chain's forest; see `forward_dynamics_vjp` for arguments and errors."""
    what, places, results = "forward_dynamics_vjp", chain_arguments(chain), chain_results(chain)
    require_names(what, by, [*places])
    require_names(what, cotangents, [*results])
    at, result = _point(chain, state, tau, inputs, check)
    z_bar = {place.name: np.zeros_like(vars(result.bodies)[place.name]) for place in _of(results, cotangents)}
    for name, x in cotangents.items():
        results[name].add(checks.numbers(x, results[name].shape, name, StateError), z_bar)
    found = backward(at, z_bar, _forest_names(places, by))
    return finite_derivatives(result, {name: places[name].of(found) for name in by})


def mechanism_jvp(
    chain: ClosedChain,
    state: State,
    tau: ArrayLike,
    along: Mapping[str, ArrayLike],
    inputs: Inputs | None,
    check: bool,
) -> Derivatives:
    """Return rates by a chain's forest; see `forward_dynamics_jvp` for arguments and errors."""
    places, results = chain_arguments(chain), chain_results(chain)
    require_names("forward_dynamics_jvp", along, [*places])
    given = directions("forward_dynamics_jvp", along, {name: place.shape for name, place in places.items()})
    at, result = _point(chain, state, tau, inputs, check)
    every = [given] if isinstance(given, dict) else given
    rates = {name: np.stack([one[name] for one in every], axis=-1) for name in along}
    found = _rates(at, places, rates, len(every))
    own = {name: np.moveaxis(place.of(found, len(every)), -1, 0) for name, place in results.items()}
    return finite_derivatives(result, {name: x[0] if isinstance(given, dict) else x for name, x in own.items()})


def mechanism_jacobian(
    chain: ClosedChain,
    state: State,
    tau: ArrayLike,
    of: Sequence[str],
    by: Sequence[str],
    inputs: Inputs | None,
    check: bool,
) -> Derivatives:
    """Return the Jacobian by a chain's forest; see `forward_dynamics_jacobian` for arguments and errors."""
    what, places, results = "forward_dynamics_jacobian", chain_arguments(chain), chain_results(chain)
    require_names(what, of, [*results])
    require_names(what, by, [*places])
    at, result = _point(chain, state, tau, inputs, check)
    ends = np.cumsum([0, *(math.prod(place.shape) for place in _of(places, by))]).tolist()
    units = np.split(np.eye(ends[-1]), ends[1:-1])
    rates = {name: unit.reshape(*places[name].shape, ends[-1]) for name, unit in zip(by, units, strict=True)}
    columns = _rates(at, places, rates, ends[-1])
    parts = {}
    for name in of:
        x = results[name].of(columns, ends[-1])
        for argument, start, end in zip(by, ends, ends[1:], strict=False):
            parts[name, argument] = x[..., start:end].reshape(*results[name].shape, *places[argument].shape)
    return finite_derivatives(result, parts)


def _point(
    chain: ClosedChain, state: State, tau: ArrayLike, inputs: Inputs | None, check: bool
) -> tuple[ForestPoint, MechanismResult]:
    """Return forward dynamics at a state with what its derivatives need, and its result."""
    at, found = forest_point(mechanism_arguments(chain, state, tau, inputs), check)
    return at, mechanism_result(chain, found)


def _rates(
    at: ForestPoint, places: Mapping[str, ForestPlace], rates: Mapping[str, Array], count: int
) -> dict[str, Array]:
    """Return the rates of the forest's results for rates of the chain's arguments, (*shape, count) each."""
    values = at.given.values(_forest_names(places, rates))
    moved = {name: np.zeros((*x.shape, count)) for name, x in values.items()}
    for name, x in rates.items():
        places[name].add(x, moved, count)
    return forward(at, moved)


def _of(places: Mapping[str, ForestPlace], names: Iterable[str]) -> list[ForestPlace]:
    return [places[name] for name in names]


def _forest_names(places: Mapping[str, ForestPlace], names: Iterable[str]) -> list[str]:
    """Return the arrays of the forest among which some of the chain are, each once."""
    return [*dict.fromkeys(place.name for place in _of(places, names))]
