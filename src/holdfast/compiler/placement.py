"""A graph and its ports as a stage: the program that computes what is returned from what is given."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from holdfast.compiler import cpu
from holdfast.compiler.expand import lowered
from holdfast.compiler.graph import SERIAL, Graph
from holdfast.compiler.node import Node
from holdfast.compiler.program import Instruction, Output, Program, Shape
from holdfast.compiler.schedule import Wire
from holdfast.compiler.stage import Stage, stage_of
from holdfast.compiler.values import Leaf

Port = tuple[int, Leaf, Wire]  # phase, numbers of the graph, wire


@dataclass(eq=False)
class Ports:
    """The ports of one stage in the making.

    Attributes:
        given: what it takes.
        returned: what it returns.
    """

    given: list[Port] = field(default_factory=list)
    returned: list[Port] = field(default_factory=list)


class Stages:
    """Makes stages; groups whose regions take and return the same share one."""

    def __init__(self) -> None:
        self._made: dict[object, Stage] = {}

    def placed(self, name: str, graph: Graph, ports: Ports, phases: int) -> tuple[Stage, dict[str, Wire]]:
        """Return the stage of a graph with its ports, and their wires."""
        given = sorted(ports.given, key=lambda port: port[0])
        returned = sorted(ports.returned, key=lambda port: port[0])
        key = (graph, phases, *(tuple([port[:2] for port in some]) for some in (given, returned)))
        if key not in self._made:
            self._made[key] = _stage(name, graph, given, returned, phases)
        found = {f"in{k}": wire for k, (_, _, wire) in enumerate(given)}
        return self._made[key], found | {f"out{k}": wire for k, (_, _, wire) in enumerate(returned)}


def _stage(name: str, graph: Graph, given: Sequence[Port], returned: Sequence[Port], phases: int) -> Stage:
    """Return the stage that computes what is returned from what is given, phase by phase."""
    inputs: list[dict[str, Shape]] = [{} for _ in range(phases + 1)]
    outputs: list[list[str]] = [[] for _ in range(phases + 1)]
    for k, (phase, nodes, _) in enumerate(given):
        inputs[phase][f"in{k}"] = (len(nodes),)
    for k, (phase, _, _) in enumerate(returned):
        outputs[phase].append(f"out{k}")
    program = _program([nodes for _, nodes, _ in given], [nodes for _, nodes, _ in returned])
    # a processor without fma would call a library for each: it keeps products and sums apart
    return stage_of(name, lowered(program, cpu.has_fma()), inputs, outputs, program.operation_count)


def _program(given: Sequence[Leaf], returned: Sequence[Leaf]) -> Program:
    """Return the program of a graph, its inputs in the order of the ports."""
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
    """Return all nodes that others are made of, and those, in the order of their making."""
    found: set[Node] = set()
    waiting = list(nodes)
    while waiting:
        node = waiting.pop()
        if node not in found:
            found.add(node)
            waiting += node.args
    return sorted(found, key=SERIAL)


def inputs_of(nodes: Iterable[Node]) -> set[Node]:
    """Return the inputs that numbers are made of."""
    return {node for node in made_of(nodes) if node.kind == "input"}
