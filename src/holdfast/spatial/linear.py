"""A text made linear at a point: the list of its operations' slopes there, in order.

Rates are carried through it forward, and a gradient comes back through it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from holdfast.spatial.scalar import Array, Scalar


class Result(NamedTuple):
    """An array of a linear text.

    Attributes:
        shape: its shape.
        places: of its entries; -1 for those that do not vary.
    """

    shape: tuple[int, ...]
    places: tuple[int, ...]

    def taken(self, numbers: Sequence[Scalar]) -> Array:
        """Return what lies at its places, 0 for what does not vary."""
        return array_of([0.0 if place < 0 else numbers[place] for place in self.places], self.shape)


class Step(NamedTuple):
    """An operation of a linear text.

    Attributes:
        places: of the operands that vary.
        slopes: its derivatives by them.
    """

    places: tuple[int, ...]
    slopes: tuple[Scalar, ...]

    @property
    def size(self) -> int:
        """How many numbers it makes."""
        return 1

    def forward(self, found: list[Scalar]) -> None:
        """Add its rate to those of all numbers before it."""
        total: Scalar = 0.0
        for place, slope in zip(self.places, self.slopes, strict=True):
            if not is_zero(found[place]):
                total = total + slope * found[place]
        found.append(total)

    def backward(self, found: list[Scalar], own: int) -> None:
        """Carry its cotangent, which lies at a place, on to its operands."""
        for place, slope in zip(self.places, self.slopes, strict=True):
            found[place] = found[place] + found[own] * slope


class Rule(Protocol):
    """Derivatives of a function at a point, known otherwise than by its operations."""

    def rates(self, *rates: Any) -> Sequence[Array]:
        """Return how fast the results change while what is given does."""
        ...

    def gradient(self, *cotangents: Any) -> Sequence[Array]:
        """Return the gradient of sum(cotangent . result) by each of the arrays that are given."""
        ...


class Ruled(NamedTuple):
    """A function of a linear text whose derivatives a rule knows.

    Attributes:
        rule: the rule.
        given: what it depends on; -1 for entries that do not vary.
        made: shapes of its results.
    """

    rule: Rule
    given: tuple[Result, ...]
    made: tuple[tuple[int, ...], ...]

    @property
    def size(self) -> int:
        """How many numbers it makes."""
        return sum(math.prod(shape) for shape in self.made)

    def forward(self, found: list[Scalar]) -> None:
        """Add its rates to those of all numbers before it."""
        for x in self.rule.rates(*(of.taken(found) for of in self.given)):
            found += np.asarray(x).ravel().tolist()

    def backward(self, found: list[Scalar], own: int) -> None:
        """Carry its cotangents, which lie from a place on, on to what it depends on."""
        cotangents = []
        for shape in self.made:
            cotangents.append(array_of(found[own : own + math.prod(shape)], shape))
            own += math.prod(shape)
        for of, gradient in zip(self.given, self.rule.gradient(*cotangents), strict=True):
            for place, x in zip(of.places, np.asarray(gradient).ravel().tolist(), strict=True):
                if place >= 0:
                    found[place] = found[place] + x


@dataclass(frozen=True, eq=False)
class Linear:
    """A text made linear at a point.

    Attributes:
        shapes: of the arrays that are varied; their entries have the first places.
        steps: the operations that results depend on, in order.
        results: what it returns.
    """

    shapes: tuple[tuple[int, ...], ...]
    steps: tuple[Step | Ruled, ...]
    results: tuple[Result, ...]

    def rates(self, *rates: Any) -> list[Array]:
        """Return how fast the results change while the arrays do, at rates of their shapes."""
        found = [x for array in rates for x in np.asarray(array).ravel().tolist()]
        for step in self.steps:
            step.forward(found)
        return [of.taken(found) for of in self.results]

    def gradient(self, *cotangents: Any) -> tuple[Array, ...]:
        """Return the gradient of sum(cotangent . result) by each of the arrays varied, in their shapes.

        Args:
            cotangents: of the results, in their shapes.
        """
        sizes = [int(np.prod(shape)) for shape in self.shapes]
        own = sum(sizes) + sum(step.size for step in self.steps)
        found: list[Scalar] = [0.0] * own
        for (_, places), cotangent in zip(self.results, cotangents, strict=True):
            for place, x in zip(places, np.asarray(cotangent).ravel().tolist(), strict=True):
                if place >= 0:
                    found[place] = found[place] + x
        for step in reversed(self.steps):
            own -= step.size
            step.backward(found, own)
        ends = np.cumsum([0, *sizes]).tolist()
        parts = zip(ends, ends[1:], self.shapes, strict=False)
        return tuple([array_of(found[begin:end], shape) for begin, end, shape in parts])


def is_zero(x: Any) -> bool:
    """Return whether a scalar is known to be zero."""
    return isinstance(x, float) and x == 0.0


def array_of(entries: Sequence[Any], shape: tuple[int, ...]) -> Array:
    """Return an array of floats, if all entries are, else of objects."""
    if all(isinstance(x, float | int) for x in entries):
        return np.array(entries, dtype=float).reshape(shape)
    made = np.empty(len(entries), dtype=object)
    made[:] = entries
    return made.reshape(shape)
