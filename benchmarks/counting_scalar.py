"""Scalars that record what is done to them, to count the operations of an algorithm's text.

Each operation becomes a node; equal operations on equal operands are one node; constants are
folded (x + 0, x * 0, x * 1, 0 / x); nodes that no output needs are not counted. Nodes also
carry a value, so algorithms that choose pivots by value run as well.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

KINDS = {"+": "add", "-": "add", "*": "mul", "/": "div", "sqrt": "sqrt", "sin": "trig", "cos": "trig"}


class Recorder:
    """Makes nodes and keeps one of each."""

    def __init__(self) -> None:
        self.nodes: dict[tuple[Any, ...], Node] = {}
        self.branches = 0

    def input(self, value: float) -> Node:
        """Return a new run-time input."""
        return self.node("input", (len(self.nodes),), value)

    def inputs(self, values: Iterable[float]) -> list[Node]:
        """Return run-time inputs of the given values."""
        return [self.input(float(v)) for v in values]

    def node(self, op: str, args: tuple[Any, ...], value: Any) -> Node:
        """Return the node of an operation, made once."""
        key = (op, *(("node", a.serial) if isinstance(a, Node) else a for a in args))
        if key not in self.nodes:
            self.nodes[key] = Node(self, op, args, value)
        return self.nodes[key]


def elementwise(operator: Callable[[Node, Any], Any]) -> Callable[[Node, Any], Any]:
    """Return the operator, leaving arrays to NumPy (which comes back element by element)."""
    return lambda self, other: NotImplemented if isinstance(other, np.ndarray) else operator(self, other)


class Node:
    """One recorded scalar (or truth value)."""

    __slots__ = ("args", "op", "recorder", "serial", "value")

    def __init__(self, recorder: Recorder, op: str, args: tuple[Any, ...], value: Any) -> None:
        self.recorder, self.op, self.args, self.value = recorder, op, args, value
        self.serial = len(recorder.nodes)

    @elementwise
    def __add__(self, other: Any) -> Any:
        return self if _is(other, 0) else _binary(self, "+", self, other)

    __radd__ = __add__

    @elementwise
    def __sub__(self, other: Any) -> Any:
        return self if _is(other, 0) else 0.0 if other is self else _binary(self, "-", self, other)

    @elementwise
    def __rsub__(self, other: Any) -> Any:
        return -self if _is(other, 0) else _binary(self, "-", other, self)

    @elementwise
    def __mul__(self, other: Any) -> Any:
        if _is(other, 0):
            return 0.0
        return self if _is(other, 1) else -self if _is(other, -1) else _binary(self, "*", self, other)

    __rmul__ = __mul__

    @elementwise
    def __truediv__(self, other: Any) -> Any:
        return self if _is(other, 1) else _binary(self, "/", self, other)

    @elementwise
    def __rtruediv__(self, other: Any) -> Any:
        return 0.0 if _is(other, 0) else _binary(self, "/", other, self)

    def __pow__(self, power: int) -> Any:
        return math.prod([self] * power)

    def __neg__(self) -> Any:
        # a sign is free: it goes into the next addition or product
        return self.args[0] if self.op == "neg" else self.recorder.node("neg", (self,), -self.value)

    def __abs__(self) -> Any:
        return self.recorder.node("abs", (self,), abs(self.value))

    def sqrt(self) -> Node:
        """Return the square root."""
        return self.recorder.node("sqrt", (self,), math.sqrt(self.value))

    def sin(self) -> Node:
        """Return the sine."""
        return self.recorder.node("sin", (self,), math.sin(self.value))

    def cos(self) -> Node:
        """Return the cosine."""
        return self.recorder.node("cos", (self,), math.cos(self.value))

    def __lt__(self, other: Any) -> Node:
        return self.recorder.node("<", (self, other), self.value < _value(other))

    def __gt__(self, other: Any) -> Node:
        return self.recorder.node("<", (other, self), self.value > _value(other))

    def __le__(self, other: Any) -> Node:
        return self.recorder.node("<=", (self, other), self.value <= _value(other))

    def __ge__(self, other: Any) -> Node:
        return self.recorder.node("<=", (other, self), self.value >= _value(other))

    def where(self, a: Any, b: Any) -> Any:
        """Return a if this truth value holds, else b."""
        if a is b or _same(a, b):
            return a
        return self.recorder.node("select", (self, a, b), _value(a if self.value else b))

    def __bool__(self) -> bool:
        self.recorder.branches += 1
        return bool(self.value)


def count(outputs: Iterable[Any]) -> Counter[str]:
    """Return how many operations of each kind the outputs need."""
    seen: set[int] = set()
    counts: Counter[str] = Counter()
    stack = [x for x in outputs if isinstance(x, Node)]
    while stack:
        node = stack.pop()
        if id(node) in seen:
            continue
        seen.add(id(node))
        kind = KINDS.get(node.op, "select" if node.op in ("select", "<", "<=") else "")
        if kind:
            counts[kind] += 1
        stack.extend(a for a in node.args if isinstance(a, Node))
    counts["total"] = sum(counts[k] for k in ("add", "mul", "div", "sqrt", "trig"))
    return counts


def _binary(node: Node, op: str, a: Any, b: Any) -> Any:
    compute: dict[str, Callable[[float, float], float]] = {
        "+": lambda x, y: x + y,
        "-": lambda x, y: x - y,
        "*": lambda x, y: x * y,
        "/": lambda x, y: x / y,
    }
    if op in "+*" and _rank(a) > _rank(b):
        a, b = b, a  # commutative: one node for both orders
    return node.recorder.node(op, (a, b), compute[op](_value(a), _value(b)))


def _value(x: Any) -> Any:
    return x.value if isinstance(x, Node) else x


def _rank(x: Any) -> int:
    """Return the order of an operand: constants first, then nodes as they were made."""
    return x.serial if isinstance(x, Node) else -1


def _is(x: Any, constant: float) -> bool:
    return not isinstance(x, Node) and x == constant


def _same(a: Any, b: Any) -> bool:
    return not isinstance(a, Node) and not isinstance(b, Node) and a == b
