"""The expression graph: every node made once."""

from __future__ import annotations

from holdfast.compiler import algebra
from holdfast.compiler.arithmetic import OPERATIONS
from holdfast.compiler.errors import CompileError, place_of_call
from holdfast.compiler.node import Node

Value = Node | float


class Graph:
    """Makes nodes; the same operation on the same operands gives the same node.

    Attributes:
        nodes: all nodes, operands before their uses.
    """

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self._known: dict[tuple[object, ...], Node] = {}

    def input(self) -> Node:
        """Return a new run-time input."""
        return self._new("input", (), 0.0)

    def constant(self, value: float) -> Node:
        """Return the node of a number; 0.0 and -0.0 are two."""
        key = ("constant", value.hex())
        if key not in self._known:
            self._known[key] = self._new("constant", (), value)
        return self._known[key]

    def known(self, kind: str, *args: Value) -> Node | None:
        """Return the node of an operation if it was made before."""
        return self._known.get((kind, *(self._node(a).serial for a in args)))

    def make(self, kind: str, *args: Value) -> Node:
        """Return the node of an operation as it stands, without simplifying."""
        nodes = tuple(self._node(a) for a in args)
        key = (kind, *(a.serial for a in nodes))
        if key not in self._known:
            self._known[key] = self._new(kind, nodes, 0.0)
        return self._known[key]

    def apply(self, kind: str, *args: Value) -> Value:
        """Return an operation's result, simplified: a number if it is known already."""
        numbers = args[1:] if kind == "select" else args
        for a in args:
            if isinstance(a, Node) and a.graph is not self:
                raise CompileError(f"{place_of_call()}: operands of two different traces meet")
        if any(isinstance(a, Node) and a.is_truth for a in numbers):
            raise CompileError(
                f"{place_of_call()}: expected a number, got the truth of a comparison; try where(condition, 1.0, 0.0)"
            )
        if kind in OPERATIONS and not any(isinstance(a, Node) for a in args):
            return OPERATIONS[kind](*args)
        rule = algebra.RULES.get(kind)
        return rule(self, *args) if rule else self.make(kind, *args)

    def _node(self, x: Value) -> Node:
        return x if isinstance(x, Node) else self.constant(x)

    def _new(self, kind: str, args: tuple[Node, ...], value: float) -> Node:
        node = Node(self, len(self.nodes), kind, args, value)
        self.nodes.append(node)
        return node
