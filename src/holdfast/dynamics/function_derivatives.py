"""Gradients, rates and Jacobians of the functions that need no linear solve; see `linearised_function`.

A Jacobian is computed with one gradient per row.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from holdfast.dynamics.derivatives import Derivatives, directions, gradient_shapes, require_names, with_link_wrenches
from holdfast.dynamics.linearised_function import Differentiable, LinearisedFunction, Shape, linearised_function
from holdfast.dynamics.varied_case import VariedCase
from holdfast.errors import StateError
from holdfast.model import checks
from holdfast.model.closed_chain import ClosedChain
from holdfast.spatial.scalar import Array
from holdfast.state import Inputs, State


def case_of(chain: ClosedChain, state: State, inputs: Inputs | None, own: Mapping[str, Array]) -> VariedCase:
    """Return the arguments of a function as a case."""
    return VariedCase(chain, state, with_link_wrenches(chain, inputs), own)


def function_vjp(
    function: Differentiable, case: VariedCase, result: Any, by: Sequence[str], cotangents: Mapping[str, ArrayLike]
) -> Derivatives:
    """Return the gradients of sum(cotangent . result) by some arguments, at a few times the cost of the function."""
    what = f"{function.name}_vjp"
    require_names(what, cotangents, function.results)
    with np.errstate(all="ignore"):
        at = _linear(function, case, by, what)
        checked = {name: checks.numbers(x, at.shapes[name], name, StateError) for name, x in cotangents.items()}
        return _found(function, what, result, at.gradient(checked))


def function_jvp(
    function: Differentiable, case: VariedCase, result: Any, along: Mapping[str, ArrayLike]
) -> Derivatives:
    """Return the rates of the results for given rates of the arguments, in one direction or several."""
    what = f"{function.name}_jvp"
    checks.instance(along, Mapping, f"{what}: along", StateError)
    with np.errstate(all="ignore"):
        at = _linear(function, case, tuple(along), what)
        given = directions(what, along, argument_shapes(case))
        if isinstance(given, dict):
            return _found(function, what, result, at.rates(given))
        found = [at.rates(one) for one in given]
    parts = {name: [one[name] for one in found] for name in function.results}
    return _found(
        function, what, result, {name: np.reshape(x, (len(given), *at.shapes[name])) for name, x in parts.items()}
    )


def function_jacobian(
    function: Differentiable, case: VariedCase, result: Any, of: Sequence[str], by: Sequence[str]
) -> Derivatives:
    """Return the Jacobian, computed with one gradient per row."""
    what = f"{function.name}_jacobian"
    require_names(what, of, function.results)
    parts: dict[tuple[str, str], Array] = {}
    with np.errstate(all="ignore"):
        at, shapes = _linear(function, case, by, what), argument_shapes(case)
        for name in of:
            shape = at.shapes[name]
            rows = at.rows(name, np.eye(int(np.prod(shape))))
            parts |= {(name, x): np.reshape(rows[x], (*shape, *shapes[x])) for x in by}
    return _found(function, what, result, parts)


def argument_shapes(case: VariedCase) -> dict[str, Shape]:
    """Return the shapes of the gradients with respect to every argument."""
    return gradient_shapes(case.chain) | {name: x.shape for name, x in case.own.items()}


def _linear(function: Differentiable, case: VariedCase, by: Sequence[str], what: str) -> LinearisedFunction:
    """Return the linearisation of a function.

    Raises:
        StateError: the function does not have one of the arguments.
    """
    require_names(what, by, function.arguments_at(case.chain, case.own))
    return linearised_function(function, case, by)


def _found(function: Differentiable, what: str, result: Any, parts: Mapping[Any, Array]) -> Derivatives:
    """Return the derivatives after checking that they are finite.

    Raises:
        StateError: some are not; the message names them.
    """
    values = np.concatenate([np.zeros(0), *map(np.ravel, _arrays_of(result))])
    finite = np.where(np.isposinf(values), 0.0, values) if function.unlimited else values
    for name, x in {"result": finite, **parts}.items():
        if not np.isfinite(x).all():
            raise StateError(f"{what}: {name}: expected finite numbers, got an overflow; try smaller ones")
    return Derivatives(result, parts)


def _arrays_of(result: Any) -> list[Any]:
    """Return the arrays of a result, which may be nested in tuples and mappings."""
    if isinstance(result, Mapping | tuple):
        parts = result.values() if isinstance(result, Mapping) else result
        return [x for part in parts for x in _arrays_of(part)]
    return [result]
