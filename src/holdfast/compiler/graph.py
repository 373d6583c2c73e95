"""The expression graph: equal operations share a node, and operations are simplified before a node is made.

Constants are folded, neutral operands are dropped, and signs are moved outward. No simplification changes a rounded
result. Only two things are not preserved, on which an algorithm must not rely: the sign of a zero, and the NaN of
0 * inf, inf - inf and 0 / 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from operator import attrgetter
from typing import Any, TypeGuard

from holdfast.compiler.arithmetic import OPERATIONS, TRUTHS
from holdfast.compiler.errors import CompileError, place_of_call
from holdfast.compiler.node import Node

Value = Node | float

SERIAL = attrgetter("serial")


class Graph:
    """Makes nodes; the same operation on the same operands gives the same node.

    Attributes:
        nodes: all nodes, operands before their uses.
    """

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self._known: dict[tuple[object, ...], Node] = {}
        self._constants: dict[str, Node] = {}

    def clear(self) -> None:
        """Forget all nodes, which refer to the graph as it does to them: only the garbage collector would free them."""
        self.nodes.clear()
        self._known.clear()
        self._constants.clear()

    def input(self) -> Node:
        """Return a new run-time input."""
        return self.new("input", (), 0.0)

    def inputs(self, count: int) -> list[Node]:
        """Return new run-time inputs."""
        first = len(self.nodes)
        new = [Node(self, serial, "input", (), 0.0) for serial in range(first, first + count)]
        self.nodes += new
        return new

    def constant(self, value: float) -> Node:
        """Return the node of a number; 0.0 and -0.0 have different nodes."""
        bits = value.hex()
        node = self._constants.get(bits)
        if node is None:
            node = self._constants[bits] = self.new("constant", (), value)
        return node

    def known(self, kind: str, *args: Value) -> Node | None:
        """Return the node of an operation if it exists already, otherwise None."""
        return self._known.get((kind, *self._nodes(args)))

    def make(self, kind: str, *args: Value) -> Node:
        """Return the node of an operation without simplifying it."""
        nodes = self._nodes(args)
        key = (kind, *nodes)
        node = self._known.get(key)
        if node is None:
            node = self._known[key] = Node(self, len(self.nodes), kind, nodes, 0.0)
            self.nodes.append(node)
        return node

    def apply(self, kind: str, *args: Value) -> Value:
        """Return the simplified result of an operation: a node, or a number if all operands are known."""
        traced = False
        for a in args:
            if isinstance(a, Node):
                traced = True
                if a.graph is not self:
                    raise CompileError(f"{place_of_call()}: operands of two different traces meet")
                if a.kind in TRUTHS and (kind != "select" or a is not args[0]):
                    raise CompileError(
                        f"{place_of_call()}: expected a number, got the truth of a comparison;"
                        " try where(condition, 1.0, 0.0)"
                    )
        if not traced and kind in OPERATIONS:
            return OPERATIONS[kind](*args)
        rule = RULES.get(kind)
        return rule(self, *args) if rule else self.make(kind, *args)

    def _nodes(self, args: tuple[Value, ...]) -> tuple[Node, ...]:
        for a in args:
            if not isinstance(a, Node):
                return tuple([a if isinstance(a, Node) else self.constant(a) for a in args])
        return args  # type: ignore[return-value]  # all are nodes

    def new(self, kind: str, args: tuple[Node, ...], value: float) -> Node:
        """Add a node to the graph and return it."""
        node = Node(self, len(self.nodes), kind, args, value)
        self.nodes.append(node)
        return node


# The functions below simplify one kind of operation each; their operands are nodes or floats, one of them a node.
# They call each other directly, not through `apply`, because their operands have passed its checks.


def add(graph: Graph, a: Any, b: Any) -> Any:
    """Return a + b."""
    a, b = ordered(a, b)
    if isinstance(b, float) and b == 0.0:
        return a
    if is_negated(b):
        return subtract(graph, a, b.args[0])
    if is_negated(a):
        return subtract(graph, b, a.args[0])
    return graph.make("add", a, b)


def subtract(graph: Graph, a: Any, b: Any) -> Any:
    """Return a - b."""
    if a is b:
        return 0.0
    if isinstance(b, float):
        return add(graph, a, -b)  # one node for x - 2 and x + -2
    if is_negated(b):
        return add(graph, a, b.args[0])
    if is_negated(a):
        return negate(graph, add(graph, a.args[0], b))
    if isinstance(a, float) and a == 0.0:
        return negate(graph, b)
    if graph.known("subtract", b, a) is not None:  # x - y and y - x share a node
        return negate(graph, graph.make("subtract", b, a))
    return graph.make("subtract", a, b)


def multiply(graph: Graph, a: Any, b: Any) -> Any:
    """Return a * b."""
    a, b = ordered(a, b)
    if is_negated(a):
        return negate(graph, multiply(graph, a.args[0], b))
    if is_negated(b):
        return negate(graph, multiply(graph, a, b.args[0]))
    if isinstance(b, float):
        if b == 0.0:
            return 0.0
        if b == 1.0:
            return a
        if b < 0.0:
            return negate(graph, multiply(graph, a, -b))
    return graph.make("multiply", a, b)


def divide(graph: Graph, a: Any, b: Any) -> Any:
    """Return a / b; division by a power of two becomes a product, which rounds the same."""
    if isinstance(a, float):
        if a == 0.0:
            return 0.0
        if a < 0.0:
            return negate(graph, divide(graph, -a, b))
    if isinstance(b, float):
        if b < 0.0:
            return negate(graph, divide(graph, a, -b))
        if math.frexp(b)[0] == 0.5 and math.isfinite(1.0 / b):
            return multiply(graph, a, 1.0 / b)
    if is_negated(a):
        return negate(graph, divide(graph, a.args[0], b))
    if is_negated(b):
        return negate(graph, divide(graph, a, b.args[0]))
    return graph.make("divide", a, b)


def negate(graph: Graph, x: Any) -> Any:
    """Return -x; a following sum or difference absorbs the sign."""
    if isinstance(x, float):
        return -x
    return x.args[0] if is_negated(x) else graph.make("negate", x)


def absolute(graph: Graph, x: Any) -> Any:
    """Return |x|."""
    return graph.make("absolute", x.args[0]) if x.kind in ("negate", "absolute") else graph.make("absolute", x)


def fma(graph: Graph, a: Any, b: Any, c: Any) -> Any:
    """Return a b + c rounded once."""
    a, b = ordered(a, b)
    if isinstance(b, float) and b in (0.0, 1.0, -1.0) and not isinstance(a, float):
        return c if b == 0.0 else graph.apply("add" if b == 1.0 else "subtract", c, a)
    if isinstance(c, float) and c == 0.0:
        return multiply(graph, a, b)
    return graph.make("fma", a, b, c)


def less(graph: Graph, a: Any, b: Any) -> Any:
    """Return a < b; that of 1/2 and a truth value as a number, 1 or 0, is the truth value."""
    if isinstance(a, float) and a == 0.5 and b.kind == "select":
        _, yes, no = b.args
        if yes.kind == no.kind == "constant" and (yes.value, no.value) == (1.0, 0.0):
            return b.args[0]
    return False if a is b else graph.make("less", a, b)


def select(graph: Graph, condition: Any, a: Any, b: Any) -> Any:
    """Return a if the condition holds, else b."""
    if not isinstance(condition, Node):
        return a if condition else b
    same = a.hex() == b.hex() if isinstance(a, float) and isinstance(b, float) else a is b
    return a if same else graph.make("select", condition, a, b)


def ordered(a: Any, b: Any) -> tuple[Any, Any]:
    """Return the operands of a commutative operation in canonical order: nodes by serial number, then floats."""
    if isinstance(b, float):
        return a, b
    return (b, a) if isinstance(a, float) or a.serial > b.serial else (a, b)


def is_negated(x: Any) -> TypeGuard[Node]:
    """Return whether x is a `negate` node."""
    return isinstance(x, Node) and x.kind == "negate"


RULES: dict[str, Callable[..., Any]] = {
    rule.__name__: rule for rule in (add, subtract, multiply, divide, negate, absolute, fma, less, select)
}
