"""Rates of the wrenches of force elements between bodies, from the linearisation of `with_force_elements`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from holdfast.dynamics.closed.force_elements import with_force_elements
from holdfast.dynamics.closed.forward_derivatives import forward_along
from holdfast.dynamics.closed.second_solve import Point
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import Shape
from holdfast.questions.case import OF_INPUTS, VariedCase
from holdfast.questions.linearised_function import LinearisedFunction, linearised_function
from holdfast.questions.question import Question
from holdfast.spatial.scalar import Array

# The arguments that move the ends of force elements.
MOVING_ENDS = (
    *("q", "qd", "object_pose", "object_twist", "base_pose", "base_twist"),
    *("floating_pose", "floating_twist", "trunk_base_twist"),
)


def force_element_rates(case: VariedCase, names: Sequence[str]) -> LinearisedFunction | None:
    """Return the linearisation of the elements' wrenches in those of the named arguments on which they depend.

    Returns:
        The linearisation; None if there are no elements, or if none of the arguments moves their ends.
    """
    names = tuple(name for name in names if name in MOVING_ENDS)
    return linearised_function(_elements(case.chain), case, names) if case.chain.springs and names else None


def pushforward(elements: LinearisedFunction | None, tangents: Mapping[str, Array]) -> Mapping[str, Array]:
    """Return tangents of forward dynamics with the rates of the elements' wrenches added."""
    if elements is None:
        return tangents
    added = elements.rates({name: tangents[name] for name in elements.names if name in tangents})
    return {**tangents, **{name: tangents.get(name, 0.0) + x for name, x in added.items()}}


def pushforward_along(
    at: Point, elements: LinearisedFunction | None, shapes: Mapping[str, Shape]
) -> Callable[[Mapping[str, Array]], dict[str, Array]]:
    """Return `forward_along` with the rates of the elements' wrenches."""
    if elements is None:
        return forward_along(at, shapes)
    still = pushforward(elements, {name: np.zeros(shape) for name, shape in shapes.items()})
    along = forward_along(at, {name: np.shape(x) for name, x in still.items()})
    return lambda tangents: along(pushforward(elements, tangents))


def with_pullback(
    elements: LinearisedFunction | None, by: Sequence[str], gradients: Callable[[Sequence[str]], Mapping[str, Array]]
) -> dict[str, Array]:
    """Return gradients of forward dynamics by some arguments, with those through the elements' wrenches added.

    Args:
        elements: the linearisation of the elements' wrenches; None if they do not change.
        by: the arguments.
        gradients: of forward dynamics by named arguments, wrenches held.
    """
    if elements is None:
        return dict(gradients(by))
    found = gradients(tuple(dict.fromkeys((*by, *elements.function.names))))
    more = elements.gradient({name: found[name] for name in elements.function.names})
    return {name: found[name] + more[name] if name in more else found[name] for name in by}


def _elements(chain: ClosedChain) -> Question:
    wrenches = ("object_wrench", "link_wrench", *([] if chain.trunk is None else ["trunk_link_wrench"]))

    def of(case: VariedCase) -> tuple[Array, ...]:
        found = with_force_elements(case.chain, case.state, case.inputs)
        return tuple(getattr(found, OF_INPUTS[name]) for name in wrenches)

    return Question("force_elements", of, wrenches, arguments=MOVING_ENDS)
