"""A scalar whose value is not known yet, with which a function computes while it is traced."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NoReturn

from holdfast.compiler.arithmetic import TRUTHS
from holdfast.compiler.constant import NUMBER_TYPES, Constant, Operators
from holdfast.compiler.errors import CompileError, place_of_call

if TYPE_CHECKING:
    from holdfast.compiler.graph import Graph

_NUMBER_TYPES = (*NUMBER_TYPES, Constant)


def _misuse(what: str, instead: str) -> Callable[..., NoReturn]:
    """Return a method that raises an error, because its result would have to be known while tracing."""

    def refuse(self: Node, *_: Any) -> NoReturn:
        raise CompileError(f"{place_of_call()}: {what} of a traced value, which is known only at run time; {instead}")

    return refuse


class Node(Operators):
    """The result of one operation on other nodes: a float64, or a truth value if it is a comparison.

    Only a `Graph` makes nodes; within a graph, equal operations are the same object.

    Attributes:
        graph: the graph to which it belongs.
        serial: its index in the graph's list of nodes.
        kind: `input`, `constant`, an operation of `arithmetic.OPERATIONS`, or one that is written in these, such
            as `sin`.
        args: the operands.
        value: the number, if it is a constant; otherwise 0.
    """

    __slots__ = ("args", "graph", "kind", "serial", "value")

    def __init__(self, graph: Graph, serial: int, kind: str, args: tuple[Node, ...], value: float) -> None:
        self.graph, self.serial, self.kind, self.args, self.value = graph, serial, kind, args, value

    @property
    def is_truth(self) -> bool:
        """Whether it is a truth value rather than a number."""
        return self.kind in TRUTHS

    def _operation(self, kind: str, a: Any, b: Any) -> Any:
        """Return the result of an operation; arrays are left to NumPy, which comes back for each entry."""
        other = b if a is self else a
        if not isinstance(other, Node):
            if not isinstance(other, _NUMBER_TYPES):
                return NotImplemented
            a, b = (self, float(other)) if a is self else (float(other), self)
        return self.graph.apply(kind, a, b)

    def __neg__(self) -> Any:
        return self.graph.apply("negate", self)

    def __abs__(self) -> Any:
        return self.graph.apply("absolute", self)

    def __pow__(self, power: Any) -> Any:
        """Return an integer power, by repeated squaring."""
        if isinstance(power, Node) or not isinstance(power, NUMBER_TYPES) or power != int(power):
            raise CompileError(f"{place_of_call()}: expected an integer power of a traced value, got {power!r}")
        exponent, square, result = abs(int(power)), self, 1.0
        while exponent:
            if exponent & 1:
                result = square * result
            exponent >>= 1
            if exponent:
                square = square * square
        return 1.0 / result if power < 0 else result

    def sqrt(self) -> Any:
        """Return the square root."""
        return self.graph.apply("sqrt", self)

    def sin(self) -> Any:
        """Return the sine."""
        return self.graph.apply("sin", self)

    def cos(self) -> Any:
        """Return the cosine."""
        return self.graph.apply("cos", self)

    def exp(self) -> Any:
        """Return the exponential."""
        return self.graph.apply("exp", self)

    def tanh(self) -> Any:
        """Return the hyperbolic tangent."""
        return self.graph.apply("tanh", self)

    def arctan2(self, x: Any) -> Any:
        """Return the angle of a point, of which this is y."""
        return self.graph.apply("arctan2", self, _operand(x))

    def arctan2_of(self, y: Any) -> Any:
        """Return the angle of a point, of which this is x."""
        return self.graph.apply("arctan2", _operand(y), self)

    def fma(self, b: Any, c: Any) -> Any:
        """Return self b + c, rounded once."""
        return self.graph.apply("fma", self, _operand(b), _operand(c))

    def where(self, a: Any, b: Any) -> Any:
        """Return a if this truth value holds, else b; both are evaluated."""
        if not self.is_truth:
            raise CompileError(f"{place_of_call()}: expected a comparison as the condition of `where`, got a number")
        return self.graph.apply("select", self, _operand(a), _operand(b))

    __hash__ = object.__hash__
    _choose = "try where(less(x, y), a, b), minimum, maximum or clip of holdfast.spatial.scalar"
    __bool__ = _misuse("the truth (`if`, `and`, `not`, max, sorting)", _choose)
    __eq__ = _misuse("equality (==, in)", "compare with < or <=, or with `is` for identity")  # type: ignore[assignment]
    __ne__ = _misuse("inequality (!=)", "compare with < or <=")  # type: ignore[assignment]
    __float__ = _misuse(
        "the number (float, math.*, writing into a float array)", "try holdfast.spatial.scalar's functions"
    )
    __int__ = _misuse("the integer (int)", _choose)
    __index__ = _misuse("an index", _choose)
    __complex__ = _misuse("the complex number", "use real arithmetic")

    def __repr__(self) -> str:
        """Return a short description; operands by serial number."""
        return f"<{self.kind} #{self.serial} of {', '.join(f'#{a.serial}' for a in self.args) or 'nothing'}>"


def _operand(x: Any) -> Any:
    if isinstance(x, Node):
        return x
    if isinstance(x, _NUMBER_TYPES):
        return float(x)
    raise CompileError(
        f"{place_of_call()}: expected a number, got {type(x).__name__}; arrays go entry by entry (select)"
    )
