"""The expression graph: every node made once."""

from __future__ import annotations

from operator import attrgetter

from holdfast.compiler import algebra
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

    def input(self) -> Node:
        """Return a new run-time input."""
        return self._new("input", (), 0.0)

    def constant(self, value: float) -> Node:
        """Return the node of a number; 0.0 and -0.0 are two."""
        bits = value.hex()
        node = self._constants.get(bits)
        if node is None:
            node = self._constants[bits] = self._new("constant", (), value)
        return node

    def known(self, kind: str, *args: Value) -> Node | None:
        """Return the node of an operation if it was made before."""
        return self._known.get((kind, *map(SERIAL, self._nodes(args))))

    def make(self, kind: str, *args: Value) -> Node:
        """Return the node of an operation as it stands, without simplifying."""
        nodes = self._nodes(args)
        key = (kind, *[node.serial for node in nodes])
        node = self._known.get(key)
        if node is None:
            node = self._known[key] = self._new(kind, nodes, 0.0)
        return node

    def apply(self, kind: str, *args: Value) -> Value:
        """Return an operation's result, simplified: a number if it is known already."""
        traced = False
        for k, a in enumerate(args):
            if type(a) is Node:
                traced = True
                if a.graph is not self:
                    raise CompileError(f"{place_of_call()}: operands of two different traces meet")
                if a.kind in TRUTHS and (k or kind != "select"):
                    raise CompileError(
                        f"{place_of_call()}: expected a number, got the truth of a comparison;"
                        " try where(condition, 1.0, 0.0)"
                    )
        if not traced and kind in OPERATIONS:
            return OPERATIONS[kind](*args)
        rule = algebra.RULES.get(kind)
        return rule(self, *args) if rule else self.make(kind, *args)

    def _nodes(self, args: tuple[Value, ...]) -> tuple[Node, ...]:
        return tuple([a if type(a) is Node else self.constant(a) for a in args])

    def _new(self, kind: str, args: tuple[Node, ...], value: float) -> Node:
        node = Node(self, len(self.nodes), kind, args, value)
        self.nodes.append(node)
        return node
