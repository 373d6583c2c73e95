"""Sines and cosines of a program written out in elementary operations."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from holdfast.compiler import trigonometry
from holdfast.compiler.fuse import fuse
from holdfast.compiler.graph import Graph, Value
from holdfast.compiler.node import Node
from holdfast.compiler.program import Output, Program
from holdfast.compiler.trace import program_of


def expand(program: Program) -> Program:
    """Return the program with sines and cosines written out; it is the same one if there are none."""
    if not program.counts["sin"] and not program.counts["cos"]:
        return program
    graph = Graph()
    values = _replayed(program, graph, {"sin": trigonometry.sin, "cos": trigonometry.cos})
    return program_of(graph, program.input_shapes, [_result(graph, values, output) for output in program.outputs])


def lowered(program: Program, fused: bool = True) -> Program:
    """Return the program as interpreter and machine run it: expanded, then fused."""
    program = expand(program)
    return fuse(program) if fused else program


def _replayed(program: Program, graph: Graph, written: Mapping[str, Callable[[Value], Value]]) -> list[Value]:
    """Return what every instruction is in a new graph, where some operations are `written` out.

    The others stand as they are: they were simplified when they were traced.
    """
    values: list[Value] = []
    for kind, places, number in program.instructions:
        if kind == "input":
            values.append(graph.input())
        elif kind == "constant":
            values.append(graph.constant(number))
        elif kind in written:
            values.append(written[kind](values[places[0]]))
        else:
            values.append(graph.make(kind, *[values[p] for p in places]))
    return values


def _result(graph: Graph, values: list[Value], output: Output) -> tuple[tuple[int, ...], list[Node]]:
    return output.shape, [_node(graph, values[p]) for p in output.places]


def _node(graph: Graph, x: Value) -> Node:
    return x if isinstance(x, Node) else graph.constant(x)
