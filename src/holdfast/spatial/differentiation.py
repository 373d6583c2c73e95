"""Automatic differentiation: a function runs on numbers that record the operations by which they were computed.

The linearisation of a function at a point is the list of its operations with their partial derivatives. Forward mode
propagates rates through the list; reverse mode propagates cotangents back through it. The underlying scalars may be
floats, traced numbers, or recorded numbers again. Partial derivatives are computed with the functions of `scalar`, so
the gradient of a traced function is traced, and it contains only operations that depend on the varied arrays. Variables
in the closure of a function are constants. At a `where`, the derivative is that of the branch taken. The derivatives of
a square root at 0 and of an angle at the origin are 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import count
from typing import Any, NamedTuple

import numpy as np

from holdfast.errors import MethodNotApplicable
from holdfast.spatial.linear import Linear, LinearResult, Rule, Ruled, Step, array_of, arrays_of
from holdfast.spatial.scalar import Array, Scalar, arctan2, cos, exp, sin, sqrt, tanh, where

_levels = count(1)  # nesting level of derivatives within derivatives


class Operation(NamedTuple):
    """An operation and its partial derivatives.

    Attributes:
        of: the operation itself.
        slopes: per operand, the derivative as a function of the operands and, last, the result.
    """

    of: Callable[..., Scalar]
    slopes: tuple[Callable[..., Scalar], ...]


def _root_slope(_: Scalar, root: Scalar) -> Scalar:
    return where(root > 0.0, 0.5 / where(root > 0.0, root, 1.0), 0.0)


def _over_square(y: Scalar, x: Scalar) -> Scalar:
    square = x * x + y * y
    return where(square > 0.0, 1.0 / where(square > 0.0, square, 1.0), 0.0)


ADD = Operation(lambda a, b: a + b, (lambda *_: 1.0, lambda *_: 1.0))
SUBTRACT = Operation(lambda a, b: a - b, (lambda *_: 1.0, lambda *_: -1.0))
MULTIPLY = Operation(lambda a, b: a * b, (lambda a, b, _: b, lambda a, b, _: a))
DIVIDE = Operation(lambda a, b: a / b, (lambda a, b, _: 1.0 / b, lambda a, b, found: -(found * (1.0 / b))))
NEGATE = Operation(lambda a: -a, (lambda *_: -1.0,))
ABSOLUTE = Operation(abs, (lambda a, _: where(a < 0.0, -1.0, 1.0),))
SQRT = Operation(sqrt, (_root_slope,))
SIN = Operation(sin, (lambda a, _: cos(a),))
EXP = Operation(exp, (lambda _, found: found,))
TANH = Operation(tanh, (lambda _, found: 1.0 - found * found,))
COS = Operation(cos, (lambda a, _: -sin(a),))
ARCTAN2 = Operation(arctan2, (lambda y, x, _: x * _over_square(y, x), lambda y, x, _: -(y * _over_square(y, x))))
CHOOSE = Operation(
    where, (lambda *_: 0.0, lambda c, *_: where(c, 1.0, 0.0), lambda c, *_: where(c, 0.0, 1.0))
)  # of condition, a, b


def _both_ways(operation: Operation) -> tuple[Callable[[Any, Any], Any], Callable[[Any, Any], Any]]:
    """Return the methods of an operation for a recorded number on its left and on its right."""
    return (
        lambda self, other: _applied(operation, self, other),
        lambda self, other: _applied(operation, other, self),
    )


class Recorded:
    """A scalar whose computation is recorded on a tape.

    Attributes:
        tape: the tape.
        value: the scalar.
        place: its index on the tape.
    """

    __slots__ = ("place", "tape", "value")
    __array_priority__ = -1.0  # above NumPy's scalars and below its arrays, whose operations go entry by entry

    def __init__(self, tape: OperationTape, value: Scalar, place: int) -> None:
        self.tape, self.value, self.place = tape, value, place

    def chosen(self, condition: Any, a: Scalar, b: Scalar) -> Scalar:
        """Return `where(condition, a, b)`, recorded."""
        return _applied(CHOOSE, condition, a, b)

    __add__, __radd__ = _both_ways(ADD)
    __sub__, __rsub__ = _both_ways(SUBTRACT)
    __mul__, __rmul__ = _both_ways(MULTIPLY)
    __truediv__, __rtruediv__ = _both_ways(DIVIDE)

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

    def tanh(self) -> Any:
        """Return the hyperbolic tangent."""
        return _applied(TANH, self)

    def sin(self) -> Any:
        """Return the sine."""
        return _applied(SIN, self)

    def cos(self) -> Any:
        """Return the cosine."""
        return _applied(COS, self)

    def rint(self) -> Any:
        """Raise an error, as rounding has no derivative.

        Raises:
            MethodNotApplicable: always.
        """
        raise MethodNotApplicable(
            "derivative: expected no rounding of what is varied, got rint, a step function; try a law without a"
            " resolution"
        )

    def arctan2(self, x: Any) -> Any:
        """Return the angle of the point whose y coordinate is this number."""
        return _applied(ARCTAN2, self, x)

    def arctan2_of(self, y: Any) -> Any:
        """Return the angle of the point whose x coordinate is this number."""
        return _applied(ARCTAN2, y, self)

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


class OperationTape:
    """The record of a function's operations.

    Attributes:
        level: nesting level of the derivative; a derivative within another has a higher level.
    """

    def __init__(self) -> None:
        self.level = next(_levels)
        self._made: list[_Made | Ruled | None] = []  # None: a variable, or a further result of a rule

    def variable(self, value: Scalar) -> Recorded:
        """Return a new number that is varied."""
        self._made.append(None)
        return Recorded(self, value, len(self._made) - 1)

    def write(self, operation: Operation, operands: tuple[Any, ...]) -> Recorded:
        """Record an operation and return its result."""
        own = [isinstance(x, Recorded) and x.tape is self for x in operands]
        values = [x.value if mine else x for x, mine in zip(operands, own, strict=True)]
        found = operation.of(*values)
        places = [(k, operands[k].place) for k, mine in enumerate(own) if mine]
        self._made.append(_Made(operation, values, places, found))
        return Recorded(self, found, len(self._made) - 1)

    def write_ruled(self, found: Sequence[Any], rule: Rule, given: Sequence[Any]) -> list[Array]:
        """Record results whose derivatives a rule computes, and return them; see `by_rule`."""
        arrays, shapes = [np.asarray(x) for x in given], tuple([np.shape(x) for x in found])
        first, size = len(self._made), sum(math.prod(shape) for shape in shapes)
        given = tuple([LinearResult(x.shape, self.places(x)) for x in arrays])
        self._made += [Ruled(rule, given, shapes), *([None] * (size - 1))]
        entries = [entry for x in found for entry in np.asarray(x).ravel().tolist()]
        own = [Recorded(self, entry, first + k) for k, entry in enumerate(entries)]
        return arrays_of(own, shapes)

    def values(self, x: Any) -> Array:
        """Return an array whose entries on this record are replaced by their scalars."""
        array = np.asarray(x)
        if array.dtype != object:
            return array
        entries = [e.value if isinstance(e, Recorded) and e.tape is self else e for e in array.ravel().tolist()]
        return array_of(entries, array.shape)

    def places(self, x: Array) -> tuple[int, ...]:
        """Return the indices of an array's entries on the tape; -1 for entries that are not recorded."""
        return tuple([e.place if isinstance(e, Recorded) and e.tape is self else -1 for e in x.ravel().tolist()])

    def linear(self, shapes: tuple[tuple[int, ...], ...], results: Sequence[Any]) -> Linear:
        """Return the linearised function with these results, reduced to the operations on which they depend."""
        arrays = [np.asarray(x) for x in results]
        own = [self.places(x) for x in arrays]
        needed = {place for places in own for place in places if place >= 0}
        for at in reversed(range(len(self._made))):
            made = self._made[at]
            if made is not None and not needed.isdisjoint(range(at, at + made.size)):
                needed.add(at)
                needed.update(made.operands)
        new: dict[int, int] = {-1: -1}
        steps: list[Step | Ruled] = []
        count = until = 0
        for at, made in enumerate(self._made):
            if made is None and at >= until:
                new[at], count = count, count + 1
            elif made is not None:
                until = at + made.size
                if at in needed:
                    steps.append(made.numbered(new))
                    new |= {at + k: count + k for k in range(made.size)}
                    count += made.size
        found = zip(arrays, own, strict=True)
        return Linear(
            shapes, tuple(steps), tuple([LinearResult(a.shape, tuple([new[p] for p in o])) for a, o in found])
        )


class _Made(NamedTuple):
    """A recorded operation: the operation, its operands, their indices on the tape, and its result."""

    operation: Operation
    values: list[Scalar]
    places: list[tuple[int, int]]
    found: Scalar

    @property
    def size(self) -> int:
        return 1

    @property
    def operands(self) -> list[int]:
        return [place for _, place in self.places]

    def numbered(self, new: Mapping[int, int]) -> Step:
        slopes = tuple([self.operation.slopes[k](*self.values, self.found) for k, _ in self.places])
        return Step(tuple([new[place] for _, place in self.places]), slopes)


def by_rule(found: Sequence[Any], rule: Rule, *given: Any) -> list[Array]:
    """Return the results of a function whose derivatives a rule computes.

    Args:
        found: the results for the `bare` values of the arguments.
        rule: the rule for the derivatives at this point.
        given: the arguments of the function.
    """
    tape = _latest_tape(given)
    return [np.asarray(x) for x in found] if tape is None else tape.write_ruled(found, rule, given)


def by_rule_below(make: Callable[..., tuple[Sequence[Any], Rule]], *given: Any) -> list[Array]:
    """Return results of a function that comes with a rule; tangents of nested derivatives are unchanged.

    Args:
        make: takes what is given without its outermost derivatives, and returns the results and the rule there.
        given: what the function depends on.
    """
    tape = _latest_tape(given)
    assert tape is not None
    found, rule = make(*(tape.values(x) for x in given))
    return tape.write_ruled(found, rule, given)


def _latest_tape(given: Sequence[Any]) -> OperationTape | None:
    """Return the tape of the highest level on which an entry of some arrays is recorded."""
    tapes = [entry.tape for x in given for entry in np.asarray(x).flat if isinstance(entry, Recorded)]
    return max(tapes, key=lambda tape: tape.level, default=None)


def is_recorded(x: Any) -> bool:
    """Return whether any entry of an array is recorded on a tape."""
    array = np.asarray(x)
    return array.dtype == object and any(isinstance(entry, Recorded) for entry in array.flat)


def bare(x: Any) -> Array:
    """Return an array's values without any recording."""
    array = np.asarray(x)
    return array if array.dtype != object else array_of([_bare(entry) for entry in array.flat], array.shape)


def linearised(f: Callable[..., Sequence[Any]], *given: Any) -> Linear:
    """Return the linearisation of a function at a point.

    Args:
        f: function of arrays that returns a sequence of arrays.
        given: the arrays at which the function is linearised.
    """
    tape, arrays = OperationTape(), [np.asarray(x) for x in given]
    varied = [array_of([tape.variable(entry) for entry in x.ravel().tolist()], x.shape) for x in arrays]
    return tape.linear(tuple([x.shape for x in arrays]), f(*varied))


def gradient(f: Callable[..., Scalar], *given: Any) -> tuple[Array, ...]:
    """Return the gradient of a scalar function with respect to each argument, at a few times the function's cost."""
    return linearised(lambda *x: (f(*x),), *given).gradient(1.0)


def _applied(operation: Operation, *operands: Any) -> Any:
    """Return the result of an operation, recorded on the tape of the highest level among its operands."""
    latest: OperationTape | None = None
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
