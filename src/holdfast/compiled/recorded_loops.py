"""Loops of a function that is linearised while it is traced: the derivative of a loop is a loop over the same items.

Every item is linearised by itself, where the loop's body is traced. The record of the function around the loop gets one
entry for all items, whose rule carries rates and cotangents through them in a loop again. So derivatives have the loops
of the function, and items of one type share their code.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

from holdfast.compiler.values import Values
from holdfast.spatial.differentiation import OperationTape, Recorded, by_rule
from holdfast.spatial.linear import EachItem, Linear, array_of
from holdfast.spatial.scalar import Array, Loops, Scalar, loops


class Hole(NamedTuple):
    """The place of a number that varies, in a value without such numbers.

    Attributes:
        which: of the numbers that vary.
    """

    which: int


class OfItem(NamedTuple):
    """What a loop's body makes of one item.

    Attributes:
        value: what it returns, with holes for the numbers that vary.
        numbers: those numbers.
        linear: the body, linearised in the item's numbers that vary.
    """

    value: Any
    numbers: Array
    linear: Linear


class RecordedLoops:
    """Runs the loops of a function on recorded numbers; the numbers beneath are traced by other loops.

    Attributes:
        traced: the loops that trace the numbers beneath.
    """

    def __init__(self, traced: Loops) -> None:
        self.traced = traced
        self._varied = Values(Recorded)

    @property
    def inside(self) -> bool:
        """Whether a loop is under way; those inside it are Python's own."""
        return self.traced.inside

    def each(self, f: Callable[..., Any], items: list[tuple[Any, ...]]) -> list[Any]:
        """Return f of every item, with numbers of the record around the loop."""
        split = [self._split(f, item) for item in items]
        found = self.traced.each(made_linear, [(array_of(_values(given), (len(given),)), x) for given, x in split])
        if not any(of.numbers.size for of in found):
            return [of.value for of in found]
        rule = EachItem(tuple([of.linear for of in found]))
        given = [array_of(numbers, (len(numbers),)) for numbers, _ in split]
        varied = by_rule([of.numbers for of in found], rule, *given)
        return [_filled(of.value, x.tolist()) for of, x in zip(found, varied, strict=True)]

    def _split(self, f: Callable[..., Any], item: tuple[Any, ...]) -> tuple[list[Recorded], Any]:
        """Return the numbers of an item and then of the loop's body that vary, and both with holes for them.

        What an item and the body have in common counts twice, so that items are alike.
        """
        own, arguments = _without(self._varied, item)
        shared, body = _without(self._varied, f, len(own))
        return own + shared, (body, *arguments)

    def scan(self, f: Callable[..., Any], carry: Any, items: list[tuple[Any, ...]]) -> tuple[Any, list[Any]]:
        """Return the last carry and what was found on the way; in a loop only if nothing varies."""
        if not _without(self._varied, (f, carry, items))[0]:
            return self.traced.scan(f, carry, items)
        found = []
        for item in items:
            carry, one = f(carry, *item)
            found.append(one)
        return carry, found


@contextmanager
def recorded_loops() -> Iterator[None]:
    """Let `RecordedLoops` take the loops within the block, if loops are traced."""
    traced = loops.get()
    token = loops.set(None if traced is None else RecordedLoops(traced))
    try:
        yield
    finally:
        loops.reset(token)


def made_linear(numbers: Array, item: Any) -> OfItem:
    """Return what a loop's body makes of one item.

    Args:
        numbers: (m,) the item's numbers that vary.
        item: the body and its arguments, with holes for these numbers.
    """
    tape = OperationTape()
    f, *arguments = _filled(item, [tape.variable(x) for x in numbers.tolist()])
    found, value = _without(Values(Recorded), f(*arguments))
    linear = tape.linear((numbers.shape,), [array_of(found, (len(found),))])
    return OfItem(value, array_of(_values(found), (len(found),)), linear)


def _values(numbers: Sequence[Recorded]) -> list[Scalar]:
    return [x.value for x in numbers]


def _without(varied: Values, value: Any, first: int = 0) -> tuple[list[Recorded], Any]:
    """Return the distinct numbers of a value that vary, and the value with holes for them, counted from `first`."""
    leaves, _ = varied.leaves(value)
    holes: dict[Any, Hole] = {}
    for leaf in leaves:
        for x in leaf:
            holes.setdefault(x, Hole(first + len(holes)))
    return list(holes), varied.replaced(value, [holes] * len(leaves))


def _filled(value: Any, numbers: Sequence[Any]) -> Any:
    """Return a value with numbers in the place of its holes."""
    holes = Values(Hole)
    leaves: list[Any] = holes.leaves(value)[0]
    return holes.replaced(value, [{x: numbers[x.which] for x in leaf} for leaf in leaves])
