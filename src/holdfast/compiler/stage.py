"""A stage: one program compiled once and run for many items, in one phase or several."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from holdfast.compiler.cut import Pieces, by_phase
from holdfast.compiler.program import Program, Shape

Ports = Mapping[str, Shape]


@dataclass(frozen=True, eq=False)
class Stage:
    """A program and what it computes in each phase, for one item.

    Attributes:
        name: for messages and for the machine code.
        inputs: shapes of the arrays that each phase is given, by port.
        outputs: shapes of the arrays that each phase returns, by port.
        program: all phases as one, ready for the machine.
        pieces: the program by phase; piece k takes the inputs of all phases in order, then the
            memories of the phases before it, and returns its outputs, then its memory.
        operations: of the text, all phases: sums, products, quotients, roots and sines, before
            products and sums are fused.
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
        """Shape by port."""
        return {port: shape for phase in (*self.inputs, *self.outputs) for port, shape in phase.items()}

    def size(self, port: str) -> int:
        """Return how many numbers a port has."""
        return math.prod(self.shapes[port])


def stage_of(
    name: str,
    program: Program,
    inputs: Sequence[Ports],
    outputs: Sequence[Sequence[str]],
    operations: int | None = None,
) -> Stage:
    """Return the stage of a program that is lowered already; its text had so many operations, or as many as it."""
    shapes = iter(program.outputs)
    named = tuple({port: next(shapes).shape for port in ports} for ports in outputs)
    phases = [k for k, phase in enumerate(inputs) for _ in phase]
    pieces = by_phase(program, phases, [len(ports) for ports in outputs])
    return Stage(
        name, tuple(dict(phase) for phase in inputs), named, program, pieces, operations or program.operation_count
    )
