"""Rates of the wrenches of springs between bodies, from the linearisation of `with_springs`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from holdfast.dynamics.closed.forward_derivatives import forward_along
from holdfast.dynamics.closed.second_solve import Point
from holdfast.dynamics.closed.spring_wrenches import with_springs
from holdfast.model.closed_chain import ClosedChain
from holdfast.questions.arrays import Shape
from holdfast.questions.case import OF_INPUTS, VariedCase
from holdfast.questions.linearised_function import LinearisedFunction, linearised_function
from holdfast.questions.question import Question
from holdfast.spatial.scalar import Array

# The arguments that move the ends of springs.
MOVING_ENDS = (
    *("q", "qd", "object_pose", "object_twist", "base_pose", "base_twist"),
    *("floating_pose", "floating_twist", "trunk_base_twist"),
)


def spring_rates(case: VariedCase, names: Sequence[str]) -> LinearisedFunction | None:
    """Return the linearisation of the springs' wrenches in those of the named arguments on which they depend.

    Returns:
        The linearisation; None if there are no springs, or if none of the arguments moves their ends.
    """
    names = tuple(name for name in names if name in MOVING_ENDS)
    return linearised_function(_springs(case.chain), case, names) if case.chain.springs and names else None


def pushforward(springs: LinearisedFunction | None, tangents: Mapping[str, Array]) -> Mapping[str, Array]:
    """Return tangents of forward dynamics with the rates of the springs' wrenches added."""
    if springs is None:
        return tangents
    added = springs.rates({name: tangents[name] for name in springs.names if name in tangents})
    return {**tangents, **{name: tangents.get(name, 0.0) + x for name, x in added.items()}}


def pushforward_along(
    at: Point, springs: LinearisedFunction | None, shapes: Mapping[str, Shape]
) -> Callable[[Mapping[str, Array]], dict[str, Array]]:
    """Return `forward_along` with the rates of the springs' wrenches."""
    if springs is None:
        return forward_along(at, shapes)
    still = pushforward(springs, {name: np.zeros(shape) for name, shape in shapes.items()})
    along = forward_along(at, {name: np.shape(x) for name, x in still.items()})
    return lambda tangents: along(pushforward(springs, tangents))


def with_pullback(
    springs: LinearisedFunction | None, by: Sequence[str], gradients: Callable[[Sequence[str]], Mapping[str, Array]]
) -> dict[str, Array]:
    """Return gradients of forward dynamics by some arguments, with those through the springs' wrenches added.

    Args:
        springs: the wrenches, made linear.
        by: the arguments.
        gradients: of forward dynamics by named arguments, wrenches held.
    """
    if springs is None:
        return dict(gradients(by))
    found = gradients(tuple(dict.fromkeys((*by, *springs.function.names))))
    more = springs.gradient({name: found[name] for name in springs.function.names})
    return {name: found[name] + more[name] if name in more else found[name] for name in by}


def _springs(chain: ClosedChain) -> Question:
    wrenches = ("object_wrench", "link_wrench", *([] if chain.trunk is None else ["trunk_link_wrench"]))

    def of(case: VariedCase) -> tuple[Array, ...]:
        found = with_springs(case.chain, case.state, case.inputs)
        return tuple(getattr(found, OF_INPUTS[name]) for name in wrenches)

    return Question("springs", of, wrenches, arguments=MOVING_ENDS)
