"""Derivatives of a text: it runs on numbers that know what they were made of.

A text made linear at a point is the list of its operations' slopes there. Rates are carried through it forward, and a
gradient comes back through it. The scalars beneath may be of any kind, floats, traced numbers or recorded ones again,
and slopes are made with the words of `scalar`: the gradient of a traced text is traced, and only what depends on what
is varied is there at all. What a text closes over is held. Where it chooses, the derivative is that of the branch
taken; that of a square root at 0 is 0.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import count
from typing import Any, NamedTuple

import numpy as np

from holdfast.spatial.scalar import Array, Scalar, cos, exp, sin, sqrt, where

_levels = count(1)  # of derivatives within derivatives: a later one lies outside


class Operation(NamedTuple):
    """An operation and its partial derivatives.

    Attributes:
        of: the operation.
        slopes: per operand, its derivative as a function of the operands, then the result.
    """

    of: Callable[..., Scalar]
    slopes: tuple[Callable[..., Scalar], ...]


def _root_slope(_: Scalar, root: Scalar) -> Scalar:
    return where(root > 0.0, 0.5 / where(root > 0.0, root, 1.0), 0.0)


ADD = Operation(lambda a, b: a + b, (lambda *_: 1.0, lambda *_: 1.0))
SUBTRACT = Operation(lambda a, b: a - b, (lambda *_: 1.0, lambda *_: -1.0))
MULTIPLY = Operation(lambda a, b: a * b, (lambda a, b, _: b, lambda a, b, _: a))
DIVIDE = Operation(lambda a, b: a / b, (lambda a, b, _: 1.0 / b, lambda a, b, found: -(found * (1.0 / b))))
NEGATE = Operation(lambda a: -a, (lambda *_: -1.0,))
ABSOLUTE = Operation(abs, (lambda a, _: where(a < 0.0, -1.0, 1.0),))
SQRT = Operation(sqrt, (_root_slope,))
SIN = Operation(sin, (lambda a, _: cos(a),))
EXP = Operation(exp, (lambda _, found: found,))
COS = Operation(cos, (lambda a, _: -sin(a),))
CHOOSE = Operation(
    where, (lambda *_: 0.0, lambda c, *_: where(c, 1.0, 0.0), lambda c, *_: where(c, 0.0, 1.0))
)  # of condition, a, b


class Recorded:
    """A scalar whose making is on record.

    Attributes:
        tape: the record.
        value: the scalar.
        place: its own on the record.
    """

    __slots__ = ("place", "tape", "value")
    __array_priority__ = -1.0  # between NumPy's scalars and its arrays, which go entry by entry

    def __init__(self, tape: Tape, value: Scalar, place: int) -> None:
        self.tape, self.value, self.place = tape, value, place

    def chosen(self, condition: Any, a: Scalar, b: Scalar) -> Scalar:
        """Return what `where` does."""
        return _applied(CHOOSE, condition, a, b)

    def __add__(self, other: Any) -> Any:
        return _applied(ADD, self, other)

    def __radd__(self, other: Any) -> Any:
        return _applied(ADD, other, self)

    def __sub__(self, other: Any) -> Any:
        return _applied(SUBTRACT, self, other)

    def __rsub__(self, other: Any) -> Any:
        return _applied(SUBTRACT, other, self)

    def __mul__(self, other: Any) -> Any:
        return _applied(MULTIPLY, self, other)

    def __rmul__(self, other: Any) -> Any:
        return _applied(MULTIPLY, other, self)

    def __truediv__(self, other: Any) -> Any:
        return _applied(DIVIDE, self, other)

    def __rtruediv__(self, other: Any) -> Any:
        return _applied(DIVIDE, other, self)

    def __pow__(self, exponent: Any) -> Any:
        return _applied(MULTIPLY, self, self) if exponent == 2 else NotImplemented

    def __neg__(self) -> Any:
        return _applied(NEGATE, self)

    def __abs__(self) -> Any:
        return _applied(ABSOLUTE, self)

    def sqrt(self) -> Any:
        """Return the square root."""
        return _applied(SQRT, self)

    def exp(self) -> Any:
        """Return the exponential."""
        return _applied(EXP, self)

    def sin(self) -> Any:
        """Return the sine."""
        return _applied(SIN, self)

    def cos(self) -> Any:
        """Return the cosine."""
        return _applied(COS, self)

    def __lt__(self, other: Any) -> Any:
        return _bare(self) < _bare(other)

    def __gt__(self, other: Any) -> Any:
        return _bare(self) > _bare(other)

    def __le__(self, other: Any) -> Any:
        return _bare(self) <= _bare(other)

    def __ge__(self, other: Any) -> Any:
        return _bare(self) >= _bare(other)

    def __bool__(self) -> bool:
        raise TypeError("expected no branch on a number that is varied; try where(condition, a, b)")


class Step(NamedTuple):
    """An operation of a linear text.

    Attributes:
        places: of the operands that vary.
        slopes: its derivatives by them.
    """

    places: tuple[int, ...]
    slopes: tuple[Scalar, ...]


class Result(NamedTuple):
    """An array that a linear text returns.

    Attributes:
        shape: its shape.
        places: of its entries; -1 for those that do not vary.
    """

    shape: tuple[int, ...]
    places: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Linear:
    """A text made linear at a point.

    Attributes:
        shapes: of the arrays that are varied; their entries have the first places.
        steps: the operations that results depend on, one place each, in order.
        results: what it returns.
    """

    shapes: tuple[tuple[int, ...], ...]
    steps: tuple[Step, ...]
    results: tuple[Result, ...]

    def rates(self, *rates: Any) -> list[Array]:
        """Return how fast the results change while the arrays do, at rates of their shapes."""
        found = [x for array in rates for x in np.asarray(array).ravel().tolist()]
        for places, slopes in self.steps:
            total: Scalar = 0.0
            for place, slope in zip(places, slopes, strict=True):
                if not _is_zero(found[place]):
                    total = total + slope * found[place]
            found.append(total)
        return [_array([0.0 if p < 0 else found[p] for p in of.places], of.shape) for of in self.results]

    def gradient(self, *cotangents: Any) -> tuple[Array, ...]:
        """Return the gradient of sum(cotangent . result) by each of the arrays varied, in their shapes.

        Args:
            cotangents: of the results, in their shapes.
        """
        sizes = [int(np.prod(shape)) for shape in self.shapes]
        first = sum(sizes)
        found: list[Scalar] = [0.0] * (first + len(self.steps))
        for (_, places), cotangent in zip(self.results, cotangents, strict=True):
            for place, x in zip(places, np.asarray(cotangent).ravel().tolist(), strict=True):
                if place >= 0:
                    found[place] = found[place] + x
        for at in reversed(range(len(self.steps))):
            places, slopes = self.steps[at]
            for place, slope in zip(places, slopes, strict=True):
                found[place] = found[place] + found[first + at] * slope
        ends = np.cumsum([0, *sizes]).tolist()
        parts = zip(ends, ends[1:], self.shapes, strict=False)
        return tuple([_array(found[begin:end], shape) for begin, end, shape in parts])


class Tape:
    """The record of a text's operations.

    Attributes:
        level: of the derivative: one within which another's numbers are varied comes later.
    """

    def __init__(self) -> None:
        self.level = next(_levels)
        self._made: list[tuple[Operation, list[Scalar], list[tuple[int, int]], Scalar] | None] = []

    def variable(self, value: Scalar) -> Recorded:
        """Return a number that is varied."""
        self._made.append(None)
        return Recorded(self, value, len(self._made) - 1)

    def write(self, operation: Operation, operands: tuple[Any, ...]) -> Recorded:
        """Return an operation's result."""
        own = [isinstance(x, Recorded) and x.tape is self for x in operands]
        values = [x.value if mine else x for x, mine in zip(operands, own, strict=True)]
        found = operation.of(*values)
        self._made.append((operation, values, [(k, operands[k].place) for k, mine in enumerate(own) if mine], found))
        return Recorded(self, found, len(self._made) - 1)

    def linear(self, shapes: tuple[tuple[int, ...], ...], results: Sequence[Any]) -> Linear:
        """Return the text with these results made linear: only what they depend on."""
        arrays = [np.asarray(x) for x in results]
        own = [[x.place if isinstance(x, Recorded) and x.tape is self else -1 for x in a.flat] for a in arrays]
        needed = {place for places in own for place in places if place >= 0}
        for at in reversed(range(len(self._made))):
            made = self._made[at]
            if at in needed and made is not None:
                needed |= {place for _, place in made[2]}
        new: dict[int, int] = {-1: -1}
        steps: list[Step] = []
        count = 0
        for at, made in enumerate(self._made):
            if made is None:
                new[at], count = count, count + 1
            elif at in needed:
                operation, values, operands, found = made
                slopes = tuple([operation.slopes[k](*values, found) for k, _ in operands])
                steps.append(Step(tuple([new[place] for _, place in operands]), slopes))
                new[at], count = count, count + 1
        found = zip(arrays, own, strict=True)
        return Linear(shapes, tuple(steps), tuple([Result(a.shape, tuple([new[p] for p in o])) for a, o in found]))


def linearised(f: Callable[..., Sequence[Any]], *given: Any) -> Linear:
    """Return a text made linear.

    Args:
        f: takes arrays like those given and returns a sequence of arrays.
        given: where.
    """
    tape, arrays = Tape(), [np.asarray(x) for x in given]
    varied = [_array([tape.variable(entry) for entry in x.ravel().tolist()], x.shape) for x in arrays]
    return tape.linear(tuple([x.shape for x in arrays]), f(*varied))


def gradient(f: Callable[..., Scalar], *given: Any) -> tuple[Array, ...]:
    """Return the gradient of a scalar text by each of its arrays, in their shapes; a few times the text's cost."""
    return linearised(lambda *x: (f(*x),), *given).gradient(1.0)


def _applied(operation: Operation, *operands: Any) -> Any:
    """Return an operation's result on the latest record among its operands'."""
    latest: Tape | None = None
    for x in operands:
        if isinstance(x, Recorded):
            if latest is None or x.tape.level > latest.level:
                latest = x.tape
        elif isinstance(x, np.ndarray):
            return NotImplemented
    assert latest is not None
    return latest.write(operation, operands)


def _bare(x: Any) -> Any:
    while isinstance(x, Recorded):
        x = x.value
    return x


def _is_zero(x: Any) -> bool:
    return isinstance(x, float) and x == 0.0


def _array(entries: Sequence[Any], shape: tuple[int, ...]) -> Array:
    """Return an array of floats, if all entries are, else of objects."""
    if all(isinstance(x, float | int) for x in entries):
        return np.array(entries, dtype=float).reshape(shape)
    made = np.empty(len(entries), dtype=object)
    made[:] = entries
    return made.reshape(shape)
