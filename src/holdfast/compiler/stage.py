"""A stage: a program that is compiled once and run for many items, in one or several phases."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

from holdfast.compiler.cut import Pieces, by_phase
from holdfast.compiler.graph import SERIAL, Graph
from holdfast.compiler.lowering import lowered
from holdfast.compiler.node import Node
from holdfast.compiler.program import Instruction, Output, Program, Shape
from holdfast.compiler.values import Leaf

Ports = Mapping[str, Shape]


@dataclass(frozen=True, eq=False)
class Stage:
    """A program and what it computes in each phase, for one item.

    Attributes:
        name: its name in messages and in machine code.
        inputs: the shapes of the arrays that each phase takes, by port.
        outputs: the shapes of the arrays that each phase returns, by port.
        program: all phases as one lowered program.
        pieces: the program cut by phase. Piece k takes the inputs of all phases in order, then the
            memories of the phases before it, and returns its outputs, then its memory.
        operations: the number of operations of the traced function in all phases (sums, products, quotients, roots
            and sines), counted before products and sums are fused.
    """

    name: str
    inputs: tuple[Ports, ...]
    outputs: tuple[Ports, ...]
    program: Program
    pieces: Pieces
    operations: int

    @cached_property
    def input_ports(self) -> tuple[str, ...]:
        """All input ports, phase after phase."""
        return tuple(port for phase in self.inputs for port in phase)

    @cached_property
    def shapes(self) -> dict[str, Shape]:
        """The shape of every port."""
        return {port: shape for phase in (*self.inputs, *self.outputs) for port, shape in phase.items()}

    def size(self, port: str) -> int:
        """Return the number of entries of a port."""
        return math.prod(self.shapes[port])


def stage_of(
    name: str,
    program: Program,
    inputs: Sequence[Ports],
    outputs: Sequence[Sequence[str]],
    operations: int | None = None,
) -> Stage:
    """Return the stage of a lowered program.

    Args:
        name: its name in messages and in machine code.
        program: the lowered program; its inputs and outputs are in the order of the ports.
        inputs: the shapes of the arrays that each phase takes, by port.
        outputs: the names of the output ports of each phase.
        operations: the number of operations before lowering; by default that of `program`.
    """
    shapes = iter(program.outputs)
    named = tuple({port: next(shapes).shape for port in ports} for ports in outputs)
    phases = [k for k, phase in enumerate(inputs) for _ in phase]
    pieces = by_phase(program, phases, [len(ports) for ports in outputs])
    return Stage(
        name, tuple(dict(phase) for phase in inputs), named, program, pieces, operations or program.operation_count
    )


class Wire(NamedTuple):
    """The connection of a port to an array.

    Attributes:
        array: the name of the array.
        places: for every item of the group, the item of an internal array, or the first entry in an external array.
    """

    array: str
    places: tuple[int, ...]


Port = tuple[int, Leaf, Wire]  # phase, numbers of the graph, wire


@dataclass(eq=False)
class GraphPorts:
    """The ports of one graph.

    Attributes:
        given: its input ports.
        returned: its output ports.
    """

    given: list[Port] = field(default_factory=list)
    returned: list[Port] = field(default_factory=list)


class Stages:
    """Makes stages; groups with the same graph and the same ports share one stage."""

    def __init__(self, fused: bool = True) -> None:
        """Begin without stages; `fused` says whether products and sums become fma operations."""
        self._made: dict[object, Stage] = {}
        self._fused = fused

    def placed(self, name: str, graph: Graph, ports: GraphPorts, phases: int) -> tuple[Stage, dict[str, Wire]]:
        """Return the stage of a graph with the given ports, and the wires by port name."""
        given = sorted(ports.given, key=lambda port: port[0])
        returned = sorted(ports.returned, key=lambda port: port[0])
        key = (graph, phases, *(tuple([port[:2] for port in some]) for some in (given, returned)))
        if key not in self._made:
            self._made[key] = self._stage(name, graph, given, returned, phases)
        found = {f"in{k}": wire for k, (_, _, wire) in enumerate(given)}
        return self._made[key], found | {f"out{k}": wire for k, (_, _, wire) in enumerate(returned)}

    def _stage(self, name: str, graph: Graph, given: Sequence[Port], returned: Sequence[Port], phases: int) -> Stage:
        """Return the stage that computes the `returned` ports from the `given` ones, phase by phase."""
        inputs: list[dict[str, Shape]] = [{} for _ in range(phases + 1)]
        outputs: list[list[str]] = [[] for _ in range(phases + 1)]
        for k, (phase, nodes, _) in enumerate(given):
            inputs[phase][f"in{k}"] = (len(nodes),)
        for k, (phase, _, _) in enumerate(returned):
            outputs[phase].append(f"out{k}")
        program = _program([nodes for _, nodes, _ in given], [nodes for _, nodes, _ in returned])
        return stage_of(name, lowered(program, self._fused), inputs, outputs, program.operation_count)


def _program(given: Sequence[Leaf], returned: Sequence[Leaf]) -> Program:
    """Return the program that computes the returned nodes from the given ones, in the order of the ports."""
    inputs = [node for nodes in given for node in nodes]
    new = {node.serial: k for k, node in enumerate(inputs)}
    instructions = [Instruction("input")] * len(inputs)
    for node in made_of([node for nodes in returned for node in nodes]):
        if node.serial not in new:
            new[node.serial] = len(instructions)
            instructions.append(Instruction(node.kind, tuple([new[a.serial] for a in node.args]), node.value))
    outputs = [Output((len(nodes),), tuple([new[node.serial] for node in nodes])) for nodes in returned]
    return Program(tuple([(len(nodes),) for nodes in given]), tuple(instructions), tuple(outputs))


def made_of(nodes: Iterable[Node]) -> list[Node]:
    """Return the given nodes and all nodes on which they depend, in order of their serial numbers."""
    found: set[Node] = set()
    waiting = list(nodes)
    while waiting:
        node = waiting.pop()
        if node not in found:
            found.add(node)
            waiting += node.args
    return sorted(found, key=SERIAL)
