"""Lower a program to the operations that interpreter and machine have.

The functions sin, cos, exp, tanh and arctan2 are expanded into basic operations. A product that is used by one sum only
is fused with it into one operation that rounds once: fma(a, b, c) = a b + c.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from holdfast.compiler import elementary
from holdfast.compiler.arithmetic import OPERATIONS
from holdfast.compiler.graph import Graph, Value
from holdfast.compiler.node import Node
from holdfast.compiler.program import Output, Program, pruned
from holdfast.compiler.trace import program_of

_WRITTEN: dict[str, Callable[..., Value]] = {
    name: getattr(elementary, name) for name in ("sin", "cos", "exp", "tanh", "arctan2")
}


def expand(program: Program) -> Program:
    """Return the program with sin, cos, exp, tanh and arctan2 expanded; without any of them, it is the same object."""
    if not any(program.counts[kind] for kind in _WRITTEN):
        return program
    graph, values = Graph(), list[Value]()
    for kind, places, number in program.instructions:
        if kind == "input":
            values.append(graph.input())
        elif kind == "constant":
            values.append(graph.constant(number))
        elif kind in _WRITTEN:
            values.append(_WRITTEN[kind](*[values[p] for p in places]))
        else:  # copied unchanged, because it was simplified when it was traced
            values.append(graph.make(kind, *[values[p] for p in places]))
    return _folded(_program(program, graph, values))


def _folded(program: Program) -> Program:
    """Return the program without operations on constants, which would be computed before any input is known.

    Expanding a function of two arguments, one of which is a constant, makes such operations.
    """
    kinds = [kind for kind, _, _ in program.instructions]
    if not any(places and all(kinds[p] == "constant" for p in places) for _, places, _ in program.instructions):
        return program
    graph, values = Graph(), list[Any]()
    for kind, places, number in program.instructions:
        operands = [values[p] for p in places]
        if kind == "input":
            values.append(graph.input())
        elif kind == "constant":
            values.append(number)
        elif kind == "select" and isinstance(operands[0], bool):
            values.append(operands[1] if operands[0] else operands[2])
        elif any(isinstance(x, Node) for x in operands):
            values.append(graph.make(kind, *operands))
        else:
            values.append(OPERATIONS[kind](*operands))
    return _program(program, graph, values)


def _program(like: Program, graph: Graph, values: list[Value]) -> Program:
    """Return the program with the inputs and outputs of another, whose instructions have these values."""

    def node(place: int) -> Node:
        x = values[place]
        return x if isinstance(x, Node) else graph.constant(x)

    return program_of(graph, like.input_shapes, [(shape, [*map(node, places)]) for shape, places in like.outputs])


def lowered(program: Program, fused: bool = True) -> Program:
    """Return the program that interpreter and machine run: expanded, then fused."""
    program = expand(program)
    return fuse(program) if fused else program


_Term = tuple[int, int, bool]  # the factors of a product, and whether it is subtracted


def fuse(program: Program) -> Program:
    """Return the program with fma instructions.

    A product that is used only once, by a sum or difference, is fused with it. A sum of such products that is itself
    used only once, by a sum with another number, begins with that number, so that all its products are fused:
    x + (a b + c d) is fma(c, d, fma(a, b, x)). A sum of products alone begins with its first product. This fixes the
    bits of the result, because the machine never fuses operations on its own.
    """
    instructions = program.instructions
    uses, in_a_sum = [0] * len(instructions), [False] * len(instructions)
    for kind, args, _ in instructions:
        for a in args:
            uses[a] += 1
            in_a_sum[a] |= kind in ("add", "subtract")
    for output in program.outputs:
        for place in output.places:
            uses[place] += 1
    writer = _Writer()
    new: list[int] = []
    sums: dict[int, list[_Term]] = {}  # by place, products and sums of products for the one sum that uses them
    for place, (kind, args, value) in enumerate(instructions):
        terms: list[_Term] = []
        start = None
        if kind == "multiply":
            terms.append((new[args[0]], new[args[1]], False))
        elif kind in ("add", "subtract") and (args[0] in sums or args[1] in sums):
            for a, negative in zip(args, (False, kind == "subtract"), strict=True):
                if a in sums:
                    terms += [(x, y, sign != negative) for x, y, sign in sums.pop(a)]
                else:
                    start = writer.negative(new[a]) if negative else new[a]
        if terms and start is None and in_a_sum[place] and uses[place] == 1:
            sums[place] = terms
            new.append(-1)
        elif terms:
            new.append(writer.sum_of(terms, start))
        else:
            new.append(writer.write(kind, tuple([new[a] for a in args]), value))
    outputs = [Output(output.shape, tuple([new[p] for p in output.places])) for output in program.outputs]
    return pruned(program.input_shapes, writer.instructions, outputs)


class _Writer:
    """Writes a list of instructions, in which each constant and each negated value appears only once."""

    def __init__(self) -> None:
        self.instructions: list[tuple[str, tuple[int, ...], float]] = []
        self._known: dict[object, int] = {}

    def write(self, kind: str, args: tuple[int, ...], value: float = 0.0) -> int:
        if kind in ("constant", "negate"):
            key = (kind, value.hex()) if kind == "constant" else (kind, args)
            if key in self._known:
                return self._known[key]
            self._known[key] = len(self.instructions)
        self.instructions.append((kind, args, value))
        return len(self.instructions) - 1

    def sum_of(self, terms: Sequence[_Term], start: int | None = None) -> int:
        """Write a sum of products that begins with a number, or with the first product, which is not subtracted."""
        found = start
        for a, b, negative in terms:
            if found is None:
                found = self.write("multiply", (a, b))
                continue
            if negative and self.is_constant(b):
                b = self.negative(b)
            elif negative:
                a = self.negative(a)
            found = self.write("fma", (a, b, found))
        assert found is not None
        return found

    def is_constant(self, place: int) -> bool:
        return self.instructions[place][0] == "constant"

    def negative(self, place: int) -> int:
        kind, args, value = self.instructions[place]
        if kind == "negate":
            return args[0]
        return self.write("constant", (), -value) if kind == "constant" else self.write("negate", (place,))
