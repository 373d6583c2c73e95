"""Trace a function: run it once on nodes to record what it computes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from holdfast.compiler.errors import CompileError, place_of_failure
from holdfast.compiler.graph import SERIAL, Graph
from holdfast.compiler.node import Node
from holdfast.compiler.program import Output, Program, Shape, pruned
from holdfast.compiler.values import array_of
from holdfast.errors import HoldfastError


def trace(function: Callable[..., tuple[Any, ...]], input_shapes: Iterable[Shape]) -> Program:
    """Return the program of what a function computes.

    Args:
        function: takes one array per shape and returns a tuple of arrays and numbers. Numbers in the
            function become constants of the program; truth values are returned as 1.0 and 0.0.
        input_shapes: the shapes of the arguments.

    Raises:
        CompileError: The function does something that cannot be traced; the message names the line.
    """
    graph, shapes = Graph(), tuple([tuple(shape) for shape in input_shapes])
    arrays = [inputs(graph, shape) for shape in shapes]
    with tracing():
        found = function(*arrays)
    if not isinstance(found, tuple):
        raise CompileError(f"trace: expected the function to return a tuple of arrays, got {type(found).__name__}")
    return program_of(graph, shapes, [_result(graph, k, x) for k, x in enumerate(found)])


@contextmanager
def tracing() -> Iterator[None]:
    """Turn an error inside a traced function into a `CompileError` that names the line.

    Raises:
        CompileError: The traced function raised an error.
    """
    try:
        with np.errstate(all="ignore"):  # constants may overflow or underflow, as they would at run time
            yield
    except HoldfastError:
        raise
    except Exception as error:
        raise CompileError(
            f"{place_of_failure(error)}: this cannot be traced ({type(error).__name__}: {error}); a traced function"
            " uses + - * /, comparisons and holdfast.spatial.scalar on small arrays"
        ) from error


def program_of(graph: Graph, input_shapes: tuple[Shape, ...], results: list[tuple[Shape, list[Node]]]) -> Program:
    """Return the program that computes the given nodes of a graph; instructions keep the graph's order."""
    instructions = [(n.kind, tuple(map(SERIAL, n.args)), n.value) for n in graph.nodes]
    outputs = [Output(shape, tuple(map(SERIAL, nodes))) for shape, nodes in results]
    return pruned(input_shapes, instructions, outputs)


def inputs(graph: Graph, shape: Shape) -> np.ndarray:
    """Return a read-only array of new input nodes, so that a function cannot write into its arguments."""
    return array_of([graph.input() for _ in range(math.prod(shape))], shape)


def as_node(graph: Graph, x: Any) -> Node:
    """Return the node of a number: itself, a constant, or 1.0 or 0.0 for the truth value of a comparison."""
    if isinstance(x, Node):
        return graph.make("select", x, 1.0, 0.0) if x.is_truth else x
    return graph.constant(float(x))


def _result(graph: Graph, number: int, result: Any) -> tuple[Shape, list[Node]]:
    entries, nodes = np.asarray(result, dtype=object), []
    for x in entries.flat:
        if isinstance(x, Node) and x.graph is not graph:
            raise CompileError(f"trace: result {number} holds a value of another trace")
        try:
            nodes.append(as_node(graph, x))
        except (TypeError, ValueError) as error:
            raise CompileError(f"trace: expected numbers in result {number}, got {x!r}") from error
    return entries.shape, nodes
