"""Derivatives of a text: it runs on numbers that know what they were made of, or how fast they change.

`gradient` records every operation and goes back through the record (reverse mode); `rates_of_change` carries a rate
along (forward mode). Both wrap scalars of any kind, floats, traced numbers or each other's, and compute with the
words of `scalar`: the gradient of a traced text is traced, and only what depends on what is varied is there at all.
What a text closes over is held. Where it chooses, the derivative is that of the branch taken; that of a square root
at 0 is 0.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import count
from typing import Any, NamedTuple

import numpy as np

from holdfast.spatial.scalar import Array, Scalar, cos, sin, sqrt, where

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
COS = Operation(cos, (lambda a, _: -sin(a),))
CHOOSE = Operation(
    where, (lambda *_: 0.0, lambda c, *_: where(c, 1.0, 0.0), lambda c, *_: where(c, 0.0, 1.0))
)  # of condition, a, b


class Wrapped:
    """A scalar within a derivative.

    Attributes:
        level: of the derivative.
        value: the scalar.
    """

    __slots__ = ("level", "value")
    __array_priority__ = -1.0  # between NumPy's scalars and its arrays, which go entry by entry

    def __init__(self, level: int, value: Scalar) -> None:
        self.level, self.value = level, value

    def made(self, operation: Operation, values: list[Scalar], operands: tuple[Any, ...], found: Scalar) -> Scalar:
        """Return an operation's result, wrapped.

        Args:
            operation: what was done.
            values: the operands without this level's wrapping.
            operands: as they were.
            found: the result without it.
        """
        raise NotImplementedError

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

    def __neg__(self) -> Any:
        return _applied(NEGATE, self)

    def __abs__(self) -> Any:
        return _applied(ABSOLUTE, self)

    def sqrt(self) -> Any:
        """Return the square root."""
        return _applied(SQRT, self)

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


class Recorded(Wrapped):
    """A scalar whose making is on record.

    Attributes:
        tape: the record.
        place: its own there.
    """

    __slots__ = ("place", "tape")

    def __init__(self, tape: Tape, value: Scalar, place: int) -> None:
        super().__init__(tape.level, value)
        self.tape, self.place = tape, place

    def made(self, operation: Operation, values: list[Scalar], operands: tuple[Any, ...], found: Scalar) -> Scalar:
        """Return an operation's result, on record."""
        return self.tape.write(operation, values, operands, found)


class Tape:
    """The record of a text's operations."""

    def __init__(self) -> None:
        self.level = next(_levels)
        self._steps: list[tuple[Operation, list[Scalar], list[tuple[int, int]], Scalar] | None] = []

    def variable(self, value: Scalar) -> Recorded:
        """Return a number that is varied."""
        self._steps.append(None)
        return Recorded(self, value, len(self._steps) - 1)

    def write(self, operation: Operation, values: list[Scalar], operands: tuple[Any, ...], found: Scalar) -> Recorded:
        """Return an operation's result."""
        places = [(k, x.place) for k, x in enumerate(operands) if isinstance(x, Recorded) and x.level == self.level]
        self._steps.append((operation, values, places, found))
        return Recorded(self, found, len(self._steps) - 1)

    def slopes(self, found: Scalar) -> list[Scalar]:
        """Return the derivative of a number by every number on record, 0 where it does not depend on it."""
        slopes: list[Any] = [None] * len(self._steps)
        if _is_of(found, self.level):
            slopes[found.place] = 1.0
        for at in reversed(range(len(slopes))):
            step, slope = self._steps[at], slopes[at]
            if step is None or slope is None:
                continue
            operation, values, places, result = step
            for k, place in places:
                along = slope * operation.slopes[k](*values, result)
                slopes[place] = along if slopes[place] is None else slopes[place] + along
        return [0.0 if slope is None else slope for slope in slopes]


class Moving(Wrapped):
    """A scalar that changes.

    Attributes:
        rate: how fast.
    """

    __slots__ = ("rate",)

    def __init__(self, level: int, value: Scalar, rate: Scalar) -> None:
        super().__init__(level, value)
        self.rate = rate

    def made(self, operation: Operation, values: list[Scalar], operands: tuple[Any, ...], found: Scalar) -> Scalar:
        """Return an operation's result and how fast it changes."""
        rate: Scalar = 0.0
        for k, x in enumerate(operands):
            if _is_of(x, self.level):
                rate = rate + x.rate * operation.slopes[k](*values, found)
        return Moving(self.level, found, rate)


def gradient(f: Callable[..., Scalar], *given: Any) -> tuple[Array, ...]:
    """Return the gradient of a scalar text by each of its arrays, in their shapes; a few times the text's cost.

    Args:
        f: takes arrays like those given and returns a number.
        given: where the gradient is taken.
    """
    tape = Tape()
    varied = [_entrywise(tape.variable, x) for x in given]
    slopes = tape.slopes(f(*varied))
    return tuple([_entrywise(lambda entry: slopes[entry.place], x) for x in varied])


def rates_of_change(f: Callable[..., Sequence[Any]], given: Sequence[Any], rates: Sequence[Any]) -> list[Array]:
    """Return how fast the results of a text change while its arrays do; about twice the text's cost.

    Args:
        f: takes arrays like those given and returns a sequence of arrays.
        given: where the derivative is taken.
        rates: how fast the arrays change, in their shapes.
    """
    level = next(_levels)
    moving = [_entrywise(lambda *pair: Moving(level, *pair), x, rate) for x, rate in zip(given, rates, strict=True)]
    return [_entrywise(lambda entry: entry.rate if _is_of(entry, level) else 0.0, x) for x in f(*moving)]


def _applied(operation: Operation, *operands: Any) -> Any:
    """Return an operation's result at the outermost level of its operands."""
    level, taker = 0, None
    for x in operands:
        if isinstance(x, Wrapped) and x.level > level:
            level, taker = x.level, x
        elif isinstance(x, np.ndarray):
            return NotImplemented
    assert taker is not None
    values = [x.value if _is_of(x, level) else x for x in operands]
    return taker.made(operation, values, operands, operation.of(*values))


def _is_of(x: Any, level: int) -> bool:
    return isinstance(x, Wrapped) and x.level == level


def _bare(x: Any) -> Any:
    while isinstance(x, Wrapped):
        x = x.value
    return x


def _entrywise(f: Callable[..., Any], *given: Any) -> Array:
    """Return f of every entry of arrays of one shape; of floats, if all it returns are, else of objects."""
    arrays = [np.asarray(x) for x in given]
    found = [f(*entries) for entries in zip(*(x.ravel().tolist() for x in arrays), strict=True)]
    if all(type(x) in (float, int, np.float64) for x in found):
        return np.array(found, dtype=float).reshape(arrays[0].shape)
    made = np.empty(len(found), dtype=object)
    made[:] = found
    return made.reshape(arrays[0].shape)
