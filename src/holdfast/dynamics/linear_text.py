"""A function that solves nothing, made linear: its text, run on numbers which record their making.

A function's text takes a `VariedCase` and returns arrays. Made linear (`spatial.differentiation`) it gives gradients
backward and rates forward; what poses turn by and what arguments are called is as in `forward_dynamics_vjp`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from holdfast.dynamics.closed.forward_derivatives import POSES as OF_BODIES
from holdfast.dynamics.closed.forward_derivatives import arguments_of, symmetric
from holdfast.dynamics.closed.pose_tangents import by_motions
from holdfast.dynamics.varied_case import VariedCase
from holdfast.spatial.differentiation import linearised
from holdfast.spatial.linear import Linear
from holdfast.spatial.scalar import Array
from holdfast.spatial.vector import skew

Shape = tuple[int, ...]

POSES = (*OF_BODIES, "floating_pose")


class Text(NamedTuple):
    """A function as it is differentiated.

    Attributes:
        name: the function's.
        arguments: what it depends on, of any chain.
        results: names of what it returns.
        of: the text.
        unlimited: whether a result may be infinite, where nothing limits it.
    """

    name: str
    arguments: tuple[str, ...]
    results: tuple[str, ...]
    of: Callable[[VariedCase], tuple[Any, ...]]
    unlimited: bool = False

    def arguments_at(self, case: VariedCase) -> tuple[str, ...]:
        """Return those of its arguments that a case has."""
        return tuple(name for name in self.arguments if name in (*case.own, *arguments_of(case.chain)))


class LinearText(NamedTuple):
    """A text made linear at a case in some of its arguments.

    Attributes:
        text: the text.
        case: where.
        names: the arguments.
        numbers: what these are made of, by name.
        linear: the text made linear in `numbers`.
    """

    text: Text
    case: VariedCase
    names: tuple[str, ...]
    numbers: Mapping[str, Array]
    linear: Linear

    @property
    def shapes(self) -> dict[str, Shape]:
        """Of the results, by name."""
        return {name: of.shape for name, of in zip(self.text.results, self.linear.results, strict=True)}

    def gradient(self, cotangents: Mapping[str, Array]) -> dict[str, Array]:
        """Return the gradients of sum(cotangent . result) by the arguments; of poses by [turn; shift]."""
        bars = [cotangents.get(name, np.zeros(shape)) for name, shape in self.shapes.items()]
        found = dict(zip(self.numbers, self.linear.gradient(*bars), strict=True))
        for name in self.names:
            if name in POSES:
                R, p = _parts_of(name)
                found[name] = by_motions(found[R], self.numbers[R], found[p])
            elif name.endswith("inertia"):
                found[name] = symmetric(found[name])
        return {name: found[name] for name in self.names}

    def rates(self, tangents: Mapping[str, Array]) -> dict[str, Array]:
        """Return how fast the results change while the arguments do; those that are left out stay."""
        given: dict[str, Array] = {name: np.zeros(x.shape) for name, x in self.numbers.items()}
        for name, tangent in tangents.items():
            if name in POSES:
                R, p = _parts_of(name)
                turns = tangent[..., :3].reshape(-1, 3)
                spun = np.array([skew(turn) for turn in turns]).reshape(self.numbers[R].shape)
                given |= {R: spun @ self.numbers[R], p: tangent[..., 3:]}
            else:
                given[name] = tangent
        return dict(zip(self.text.results, self.linear.rates(*given.values()), strict=True))


def linear_text(text: Text, case: VariedCase, by: Sequence[str]) -> LinearText:
    """Return a text made linear in some of its arguments."""
    names = tuple(dict.fromkeys(by))
    numbers = case.numbers([part for name in names for part in _parts_of(name)])

    def of(*given: Array) -> tuple[Any, ...]:
        return text.of(case.varied(dict(zip(numbers, given, strict=True))))

    return LinearText(text, case, names, numbers, linearised(of, *numbers.values()))


def _parts_of(name: str) -> tuple[str, ...]:
    """Return the numbers that an argument is made of."""
    return (f"{name.removesuffix('_pose')}_R", f"{name.removesuffix('_pose')}_p") if name in POSES else (name,)
