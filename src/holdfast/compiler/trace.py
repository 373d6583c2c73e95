"""Running an algorithm's text once on nodes, to learn what it computes."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from holdfast.compiler.errors import CompileError, place_of_failure
from holdfast.compiler.graph import SERIAL, Graph
from holdfast.compiler.node import Node
from holdfast.compiler.program import Output, Program, Shape, pruned
from holdfast.errors import HoldfastError

Text = Callable[..., Any]


def trace(function: Callable[..., tuple[Any, ...]], input_shapes: Iterable[Shape]) -> Program:
    """Return what a function computes as a program.

    Args:
        function: takes one array per shape, returns a tuple of arrays and numbers. Numbers of the
            text become constants of the program; truth values come out as 1.0 and 0.0.
        input_shapes: the arguments' shapes.

    Raises:
        CompileError: naming the line of the text that does what cannot be traced.
    """
    return trace_phases(function, [tuple(input_shapes)])[0]


def trace_phases(text: Text, phases: Sequence[Sequence[Shape]]) -> tuple[Program, tuple[int, ...]]:
    """Return what a text in several phases computes, and how many results each phase has.

    Such a text is a generator: called with the arrays of the first phase it yields the results it
    can tell then, is given the arrays of the next one, and returns the last results. Between the
    phases the world acts on what was yielded; variables of the text simply stay.

    Args:
        text: a function (one phase) or a generator function.
        phases: the arguments' shapes, phase by phase.

    Raises:
        CompileError: naming the line of the text that does what cannot be traced.
    """
    graph = Graph()
    shapes = [tuple(tuple(shape) for shape in phase) for phase in phases]
    arrays = [[_inputs(graph, shape) for shape in phase] for phase in shapes]
    with running_a_text():
        results = _run(text, arrays)
    for found in results:
        if not isinstance(found, tuple):
            raise CompileError(f"trace: expected the function to return a tuple of arrays, got {type(found).__name__}")
    every = [x for found in results for x in found]
    program = program_of(graph, sum(shapes, ()), [_result(graph, k, x) for k, x in enumerate(every)])
    return program, tuple(len(found) for found in results)


@contextmanager
def running_a_text() -> Iterator[None]:
    """Name the line of a text where something cannot be traced.

    Raises:
        CompileError: naming it.
    """
    try:
        with np.errstate(all="ignore"):  # constants may overflow or vanish; what comes of it is the program's
            yield
    except HoldfastError:
        raise
    except Exception as error:
        raise CompileError(
            f"{place_of_failure(error)}: this cannot be traced ({type(error).__name__}: {error}); an algorithm's text"
            " uses + - * /, comparisons and holdfast.spatial.scalar on small arrays"
        ) from error


def _run(text: Text, arrays: list[list[np.ndarray]]) -> list[tuple[Any, ...]]:
    """Return the results of every phase."""
    running = text(*arrays[0])
    if not isinstance(running, Generator):
        if len(arrays) > 1:
            raise CompileError(f"trace: expected a generator for {len(arrays)} phases, got a plain function")
        return [running]
    results = []
    try:
        results.append(next(running))
        for given in arrays[1:]:
            results.append(running.send(tuple(given)))
    except StopIteration as end:
        if len(results) != len(arrays) - 1:
            raise CompileError(
                f"trace: expected {len(arrays)} phase(s), the text ends after {len(results) + 1}"
            ) from end
        return [*results, end.value]
    raise CompileError(f"trace: expected {len(arrays)} phase(s), the text goes on")


def program_of(graph: Graph, input_shapes: tuple[Shape, ...], results: list[tuple[Shape, list[Node]]]) -> Program:
    """Return the program that computes the given nodes of a graph, in the order of their making."""
    instructions = [(n.kind, tuple(map(SERIAL, n.args)), n.value) for n in graph.nodes]
    outputs = [Output(shape, tuple(map(SERIAL, nodes))) for shape, nodes in results]
    return pruned(input_shapes, instructions, outputs)


def _inputs(graph: Graph, shape: Shape) -> np.ndarray:
    entries = np.empty(math.prod(shape), dtype=object)
    for i in range(len(entries)):
        entries[i] = graph.input()
    entries = entries.reshape(shape)
    entries.flags.writeable = False  # a text that writes into its arguments is refused where it does
    return entries


def _result(graph: Graph, number: int, result: Any) -> tuple[Shape, list[Node]]:
    entries = np.asarray(result, dtype=object)
    return entries.shape, [_output(graph, number, x) for x in entries.flat]


def _output(graph: Graph, number: int, x: Any) -> Node:
    if isinstance(x, Node):
        if x.graph is not graph:
            raise CompileError(f"trace: result {number} holds a value of another trace")
        return graph.make("select", x, 1.0, 0.0) if x.is_truth else x
    try:
        return graph.constant(float(x))
    except (TypeError, ValueError) as error:
        raise CompileError(f"trace: expected numbers in result {number}, got {x!r}") from error
