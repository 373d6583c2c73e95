"""Lower a program to the operations that interpreter and machine have.

The functions sin, cos, exp, tanh and arctan2 are expanded into basic operations. A product that is used by one sum only
is fused with it into one operation that rounds once: fma(a, b, c) = a b + c.
"""

from __future__ import annotations

from collections.abc import Callable
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


def fuse(program: Program) -> Program:
    """Return the program with fma instructions.

    A product that is used only once, by a sum or difference, is fused with it; of two such products, the second
    operand is. This fixes the bits of the result, because the machine never fuses operations on its own.
    """
    instructions = program.instructions
    uses = [0] * len(instructions)
    for _, args, _ in instructions:
        for a in args:
            uses[a] += 1
    for output in program.outputs:
        for place in output.places:
            uses[place] += 1
    alone = [kind == "multiply" and n == 1 for (kind, _, _), n in zip(instructions, uses, strict=True)]
    writer = _Writer()
    new: list[int] = []
    for kind, args, value in instructions:
        if kind not in ("add", "subtract") or not (alone[args[0]] or alone[args[1]]):
            new.append(writer.write(kind, tuple([new[a] for a in args]), value))
            continue
        product = 1 if alone[args[1]] else 0
        a, b = (new[x] for x in instructions[args[product]].args)
        c = new[args[1 - product]]
        if kind == "subtract":
            if product == 0:
                c = writer.negative(c)
            elif writer.is_constant(b):
                b = writer.negative(b)
            else:
                a = writer.negative(a)
        new.append(writer.write("fma", (a, b, c)))
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

    def is_constant(self, place: int) -> bool:
        return self.instructions[place][0] == "constant"

    def negative(self, place: int) -> int:
        kind, args, value = self.instructions[place]
        if kind == "negate":
            return args[0]
        return self.write("constant", (), -value) if kind == "constant" else self.write("negate", (place,))
