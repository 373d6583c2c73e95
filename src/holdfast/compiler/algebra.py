"""Which operations need not be made: constants folded, neutral operands dropped, signs carried outward.

Rounded results never change: a rewritten operation rounds the same number. Only what an algorithm's
text must not rely on is given up: the sign of a zero, and NaN from 0 * inf, inf - inf, 0 / 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeGuard

from holdfast.compiler.node import Node

if TYPE_CHECKING:
    from holdfast.compiler.graph import Graph

Value = Any  # Node | float


def add(graph: Graph, a: Value, b: Value) -> Value:
    """Return a + b."""
    a, b = ordered(a, b)
    if isinstance(b, float) and b == 0.0:
        return a
    if is_negated(b):
        return graph.apply("subtract", a, b.args[0])
    if is_negated(a):
        return graph.apply("subtract", b, a.args[0])
    return graph.make("add", a, b)


def subtract(graph: Graph, a: Value, b: Value) -> Value:
    """Return a - b."""
    if a is b:
        return 0.0
    if isinstance(b, float):
        return graph.apply("add", a, -b)  # one node for x - 2 and x + -2
    if is_negated(b):
        return graph.apply("add", a, b.args[0])
    if is_negated(a):
        return graph.apply("negate", graph.apply("add", a.args[0], b))
    if isinstance(a, float) and a == 0.0:
        return graph.apply("negate", b)
    if graph.known("subtract", b, a) is not None:  # x - y and y - x share a node
        return graph.apply("negate", graph.make("subtract", b, a))
    return graph.make("subtract", a, b)


def multiply(graph: Graph, a: Value, b: Value) -> Value:
    """Return a * b."""
    a, b = ordered(a, b)
    if is_negated(a):
        return graph.apply("negate", graph.apply("multiply", a.args[0], b))
    if is_negated(b):
        return graph.apply("negate", graph.apply("multiply", a, b.args[0]))
    if isinstance(b, float):
        if b == 0.0:
            return 0.0
        if b == 1.0:
            return a
        if b < 0.0:
            return graph.apply("negate", graph.apply("multiply", a, -b))
    return graph.make("multiply", a, b)


def divide(graph: Graph, a: Value, b: Value) -> Value:
    """Return a / b; by a power of two it is a product, which rounds the same."""
    if isinstance(a, float):
        if a == 0.0:
            return 0.0
        if a < 0.0:
            return graph.apply("negate", graph.apply("divide", -a, b))
    if isinstance(b, float):
        if b < 0.0:
            return graph.apply("negate", graph.apply("divide", a, -b))
        if math.frexp(b)[0] == 0.5 and math.isfinite(1.0 / b):
            return graph.apply("multiply", a, 1.0 / b)
    if is_negated(a):
        return graph.apply("negate", graph.apply("divide", a.args[0], b))
    if is_negated(b):
        return graph.apply("negate", graph.apply("divide", a, b.args[0]))
    return graph.make("divide", a, b)


def negate(graph: Graph, x: Value) -> Value:
    """Return -x; the sign stays on the outside, for the next sum to take up."""
    return x.args[0] if is_negated(x) else graph.make("negate", x)


def absolute(graph: Graph, x: Value) -> Value:
    """Return |x|."""
    return graph.make("absolute", x.args[0]) if x.kind in ("negate", "absolute") else graph.make("absolute", x)


def fma(graph: Graph, a: Value, b: Value, c: Value) -> Value:
    """Return a b + c rounded once."""
    a, b = ordered(a, b)
    if isinstance(b, float) and b in (0.0, 1.0, -1.0) and not isinstance(a, float):
        return c if b == 0.0 else graph.apply("add" if b == 1.0 else "subtract", c, a)
    if isinstance(c, float) and c == 0.0:
        return graph.apply("multiply", a, b)
    return graph.make("fma", a, b, c)


def less(graph: Graph, a: Value, b: Value) -> Value:
    """Return a < b."""
    return False if a is b else graph.make("less", a, b)


def select(graph: Graph, condition: Value, a: Value, b: Value) -> Value:
    """Return a if the condition holds, else b."""
    if not isinstance(condition, Node):
        return a if condition else b
    same = a.hex() == b.hex() if isinstance(a, float) and isinstance(b, float) else a is b
    return a if same else graph.make("select", condition, a, b)


def ordered(a: Value, b: Value) -> tuple[Value, Value]:
    """Return the operands of a commutative operation in their one order: as made, numbers last."""
    if isinstance(b, float):
        return a, b
    return (b, a) if isinstance(a, float) or a.serial > b.serial else (a, b)


def is_negated(x: Value) -> TypeGuard[Node]:
    """Return whether x is a node's negative."""
    return isinstance(x, Node) and x.kind == "negate"


RULES: dict[str, Callable[..., Value]] = {
    rule.__name__: rule for rule in (add, subtract, multiply, divide, negate, absolute, fma, less, select)
}
