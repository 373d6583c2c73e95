"""A function linearised at a point: the list of its operations with their partial derivatives there, in order.

Forward mode propagates rates through the list; reverse mode propagates cotangents back through it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, NamedTuple, Protocol

import numpy as np

from holdfast.spatial.scalar import Array, Scalar, each


class LinearResult(NamedTuple):
    """A result of a linearised function.

    Attributes:
        shape: its shape.
        places: (shape) index of each entry among all numbers; -1 for entries that do not vary.
    """

    shape: tuple[int, ...]
    places: tuple[int, ...]

    def numbered(self, new: Mapping[int, int]) -> LinearResult:
        """Return the same with other indices."""
        return self._replace(places=tuple([new[place] for place in self.places]))

    def taken(self, numbers: Sequence[Scalar]) -> Array:
        """Return the values at the result's indices, and 0 for entries that do not vary."""
        return array_of([0.0 if place < 0 else numbers[place] for place in self.places], self.shape)


class Step(NamedTuple):
    """An operation of a linearised function.

    Attributes:
        places: indices of the operands that vary.
        slopes: its derivatives with respect to these operands.
    """

    places: tuple[int, ...]
    slopes: tuple[Scalar, ...]

    @property
    def size(self) -> int:
        """Number of results."""
        return 1

    def part(self, needed: set[int], own: int) -> tuple[Step, range] | None:
        """Return the operation with the index of its result, if that is needed, and mark its operands as needed."""
        if own not in needed:
            return None
        needed.update(self.places)
        return self, range(own, own + 1)

    def numbered(self, new: Mapping[int, int]) -> Step:
        """Return the same with other indices."""
        return self._replace(places=tuple([new[place] for place in self.places]))

    def forward(self, found: list[Scalar]) -> None:
        """Append the rate of the result to the rates of all numbers before it."""
        total: Scalar = 0.0
        for place, slope in zip(self.places, self.slopes, strict=True):
            if not is_zero(found[place]):
                total = total + slope * found[place]
        found.append(total)

    def backward(self, found: list[Scalar], own: int) -> None:
        """Propagate the cotangent of the result, at a given index, to the operands."""
        for place, slope in zip(self.places, self.slopes, strict=True):
            found[place] = found[place] + found[own] * slope


class Rule(Protocol):
    """Derivatives of a function at a point that are computed without differentiating its operations."""

    def rates(self, *rates: Any) -> Sequence[Array]:
        """Return the rates of the results for rates of the arguments."""
        ...

    def gradient(self, *cotangents: Any) -> Sequence[Array]:
        """Return the gradient of sum(cotangent . result) with respect to each argument."""
        ...


class Ruled(NamedTuple):
    """A function within a linearised function whose derivatives a rule computes.

    Attributes:
        rule: the rule.
        given: indices of the numbers on which it depends; -1 for entries that do not vary.
        made: shapes of the results.
    """

    rule: Rule
    given: tuple[LinearResult, ...]
    made: tuple[tuple[int, ...], ...]

    @property
    def size(self) -> int:
        """Number of results."""
        return sum(math.prod(shape) for shape in self.made)

    @property
    def operands(self) -> list[int]:
        """Indices of the numbers on which the results depend."""
        return [place for of in self.given for place in of.places if place >= 0]

    def part(self, needed: set[int], own: int) -> tuple[Ruled, Sequence[int]] | None:
        """Return the needed part with its results' indices, and mark the numbers on which it depends as needed."""
        ends = np.cumsum([own, *(math.prod(shape) for shape in self.made)]).tolist()
        spans = [range(begin, end) for begin, end in pairwise(ends)]
        kept = [k for k, span in enumerate(spans) if not needed.isdisjoint(span)]
        if not kept:
            return None
        found = self
        if isinstance(self.rule, EachItem):
            rule = EachItem(tuple([self.rule.items[k] for k in kept]))
            found = Ruled(rule, tuple([self.given[k] for k in kept]), tuple([self.made[k] for k in kept]))
            spans = [spans[k] for k in kept]
        needed.update(found.operands)
        return found, [place for span in spans for place in span]

    def numbered(self, new: Mapping[int, int]) -> Ruled:
        """Return the same with other indices."""
        return self._replace(given=tuple([of.numbered(new) for of in self.given]))

    def forward(self, found: list[Scalar]) -> None:
        """Append the rates of the results to the rates of all numbers before them."""
        for x in self.rule.rates(*(of.taken(found) for of in self.given)):
            found += np.asarray(x).ravel().tolist()

    def backward(self, found: list[Scalar], own: int) -> None:
        """Propagate the cotangents of the results, from a given index on, to the numbers on which they depend."""
        cotangents = arrays_of(found[own : own + self.size], self.made)
        for of, gradient in zip(self.given, self.rule.gradient(*cotangents), strict=True):
            for place, x in zip(of.places, np.asarray(gradient).ravel().tolist(), strict=True):
                if place >= 0:
                    found[place] = found[place] + x


class EachItem(NamedTuple):
    """The rule of a loop whose items are linearised separately, so that its derivatives are loops too.

    Attributes:
        items: per item, the linearised loop body, which takes one array and returns one.
    """

    items: tuple[Linear, ...]

    def rates(self, *rates: Array) -> list[Array]:
        """Return the rates of the results, item by item."""
        return each(lambda linear, x: linear.rates(x)[0], self.items, rates)

    def gradient(self, *cotangents: Array) -> list[Array]:
        """Return the gradient of each item with respect to its own array."""
        return each(lambda linear, x: linear.gradient(x)[0], self.items, cotangents)


@dataclass(frozen=True, eq=False)
class Linear:
    """A function linearised at a point.

    Attributes:
        shapes: shapes of the arrays that are varied; their entries have the first indices.
        steps: the operations on which the results depend, in order.
        results: the results of the function.
    """

    shapes: tuple[tuple[int, ...], ...]
    steps: tuple[Step | Ruled, ...]
    results: tuple[LinearResult, ...]

    def of_entries(self, result: int, entries: slice) -> tuple[Linear, tuple[int, ...]]:
        """Return the linearised function of some entries of a result, restricted to the numbers on which they depend.

        Args:
            result: index of the result.
            entries: indices of the entries in the flattened result.
        """
        chosen, first = self.results[result].places[entries], sum(math.prod(shape) for shape in self.shapes)
        needed, own, kept = {place for place in chosen if place >= 0}, first + sum(s.size for s in self.steps), []
        for step in reversed(self.steps):
            own -= step.size
            part = step.part(needed, own)
            if part is not None:
                kept.append(part)
        varied = tuple(sorted(place for place in needed if place < first))
        new = {-1: -1} | {place: k for k, place in enumerate(varied)}
        for _, made in reversed(kept):
            new |= {place: len(new) - 1 + k for k, place in enumerate(made)}
        steps = tuple([step.numbered(new) for step, _ in reversed(kept)])
        return Linear(((len(varied),),), steps, (LinearResult((len(chosen),), chosen).numbered(new),)), varied

    def rates(self, *rates: Any) -> list[Array]:
        """Return the rates of the results for rates of the arrays, in their shapes."""
        found = [x for array in rates for x in np.asarray(array).ravel().tolist()]
        for step in self.steps:
            step.forward(found)
        return [of.taken(found) for of in self.results]

    def along(self, *directions: Array) -> list[Array]:
        """Return the rates of the results along several directions at once, (.., d); floats only, and no rules.

        Args:
            directions: rates of the arrays, in their shapes with one more axis for the directions, (.., d).
        """
        count = directions[0].shape[-1]
        found = list(np.concatenate([np.reshape(x, (-1, count)) for x in directions]))
        for step in self.steps:
            assert isinstance(step, Step)
            found.append(sum((s * found[k] for k, s in zip(step.places, step.slopes, strict=True)), np.zeros(count)))
        still = np.zeros(count)
        rows = [[still if place < 0 else found[place] for place in of.places] for of in self.results]
        return [np.reshape(x, (*of.shape, count)) for of, x in zip(self.results, rows, strict=True)]

    def gradient(self, *cotangents: Any) -> tuple[Array, ...]:
        """Return the gradient of sum(cotangent . result) with respect to each varied array, in its shape.

        Args:
            cotangents: cotangents of the results, in their shapes.
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
        return tuple(arrays_of(found[: sum(sizes)], self.shapes))


def is_zero(x: Any) -> bool:
    """Return whether a scalar is known to be zero."""
    return isinstance(x, float) and x == 0.0


def array_of(entries: Sequence[Any], shape: tuple[int, ...]) -> Array:
    """Return an array of floats if all entries are floats, otherwise an array of objects."""
    if all(isinstance(x, float | int) for x in entries):
        return np.array(entries, dtype=float).reshape(shape)
    made = np.empty(len(entries), dtype=object)
    made[:] = entries
    return made.reshape(shape)


def arrays_of(entries: Sequence[Any], shapes: Sequence[tuple[int, ...]]) -> list[Array]:
    """Return a flat list as arrays of the given shapes; see `array_of`."""
    ends = np.cumsum([0, *(math.prod(shape) for shape in shapes)]).tolist()
    return [array_of(entries[begin:end], shape) for begin, end, shape in zip(ends, ends[1:], shapes, strict=False)]
