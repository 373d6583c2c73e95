"""Linearisation of functions that need no linear solve, by running their code on numbers that record operations.

The code of such a function (its "text") takes a `VariedCase` and returns arrays. Its linearisation
(`spatial.differentiation`) gives gradients in reverse mode and rates in forward mode. The names of the arguments and
the derivatives by poses are as in `forward_dynamics_vjp`.
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
    """A function to be differentiated.

    Attributes:
        name: name of the function.
        arguments: names of all its arguments, for any chain.
        results: names of its results.
        of: the code.
        unlimited: whether a result may be infinite, as a margin without a limit is.
    """

    name: str
    arguments: tuple[str, ...]
    results: tuple[str, ...]
    of: Callable[[VariedCase], tuple[Any, ...]]
    unlimited: bool = False

    def arguments_at(self, case: VariedCase) -> tuple[str, ...]:
        """Return the names of its arguments that exist in a case."""
        return tuple(name for name in self.arguments if name in (*case.own, *arguments_of(case.chain)))


class LinearText(NamedTuple):
    """The linearisation of a function in some of its arguments.

    Attributes:
        text: the function.
        case: the case at which it is linearised.
        names: names of the arguments.
        numbers: the numbers that make up these arguments, by name.
        linear: the linearisation in `numbers`.
    """

    text: Text
    case: VariedCase
    names: tuple[str, ...]
    numbers: Mapping[str, Array]
    linear: Linear

    @property
    def shapes(self) -> dict[str, Shape]:
        """Shapes of the results, by name."""
        return {name: of.shape for name, of in zip(self.text.results, self.linear.results, strict=True)}

    def gradient(self, cotangents: Mapping[str, Array]) -> dict[str, Array]:
        """Return the gradients of sum(cotangent . result) by argument; for poses with respect to [turn; shift]."""
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
        """Return the rates of the results for given rates of the arguments; missing arguments are constant."""
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
    """Return the linearisation of a function in some of its arguments."""
    names = tuple(dict.fromkeys(by))
    numbers = case.numbers([part for name in names for part in _parts_of(name)])

    def of(*given: Array) -> tuple[Any, ...]:
        return text.of(case.varied(dict(zip(numbers, given, strict=True))))

    return LinearText(text, case, names, numbers, linearised(of, *numbers.values()))


def _parts_of(name: str) -> tuple[str, ...]:
    """Return the names of the numbers that make up an argument."""
    return (f"{name.removesuffix('_pose')}_R", f"{name.removesuffix('_pose')}_p") if name in POSES else (name,)
