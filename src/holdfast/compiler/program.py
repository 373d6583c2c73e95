"""A traced algorithm as a list of instructions, operands before their uses."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate
from typing import NamedTuple

Shape = tuple[int, ...]


class Instruction(NamedTuple):
    """One operation.

    Attributes:
        kind: `input`, `constant`, or an operation.
        args: the places of the operands in the list of instructions.
        value: the number, if it is a constant; otherwise 0.
    """

    kind: str
    args: tuple[int, ...] = ()
    value: float = 0.0


class Output(NamedTuple):
    """One array of results.

    Attributes:
        shape: its shape.
        places: the indices of the instructions that compute its entries, in C order.
    """

    shape: Shape
    places: tuple[int, ...]


@dataclass(frozen=True)
class Program:
    """A function of float64 arrays without branches or loops.

    Attributes:
        input_shapes: the shapes of the arguments.
        instructions: the inputs, argument by argument in C order, then constants and operations.
        outputs: the results.
    """

    input_shapes: tuple[Shape, ...]
    instructions: tuple[Instruction, ...]
    outputs: tuple[Output, ...]

    @cached_property
    def input_size(self) -> int:
        """The number of entries of all arguments."""
        return sum(math.prod(shape) for shape in self.input_shapes)

    @cached_property
    def used_inputs(self) -> tuple[int, ...]:
        """The indices of the arguments of which instructions or outputs use some entry."""
        sizes = [math.prod(shape) for shape in self.input_shapes]
        of_array = [k for k, size in enumerate(sizes) for _ in range(size)]
        used = {a for i in self.instructions for a in i.args} | {p for o in self.outputs for p in o.places}
        return tuple(sorted({of_array[a] for a in used if 0 <= a < len(of_array)}))

    @cached_property
    def counts(self) -> Counter[str]:
        """The number of instructions of each kind, without inputs and constants."""
        return Counter(i.kind for i in self.instructions if i.kind not in ("input", "constant"))

    @cached_property
    def live_numbers(self) -> list[int]:
        """How many numbers each instruction and later ones still need, inputs excepted: inputs from their first use on.

        Constants do not count, since they are operands in memory.
        """
        first, count = self.input_size, len(self.instructions)
        begin, end = [-1] * count, [0] * count
        for k, (_, args, _) in enumerate(self.instructions[first:]):
            for a in args:
                end[a] = k
                if begin[a] < 0:
                    begin[a] = k
            begin[first + k] = k
        change = [0] * (count - first + 1)
        for place, k in enumerate(end):
            if k and self.instructions[place].kind != "constant":
                change[begin[place]] += 1
                change[k] -= 1
        return list(accumulate(change[:-1]))

    @property
    def operation_count(self) -> int:
        """The number of arithmetic operations; signs, comparisons and selections are not counted."""
        free = ("negate", "absolute", "less", "less_equal", "select")
        return sum(n for kind, n in self.counts.items() if kind not in free)


def pruned(
    input_shapes: tuple[Shape, ...],
    instructions: Sequence[tuple[str, tuple[int, ...], float]],
    outputs: Iterable[Output],
) -> Program:
    """Return the program without the instructions that no output needs; unused inputs are kept."""
    outputs = tuple(outputs)
    needed = bytearray(len(instructions))
    for output in outputs:
        for place in output.places:
            needed[place] = 1
    for place in reversed(range(len(instructions))):
        if needed[place]:
            for arg in instructions[place][1]:
                needed[arg] = 1
    kept: list[Instruction] = []
    new = [-1] * len(instructions)
    for place, (kind, args, value) in enumerate(instructions):
        if needed[place] or kind == "input":
            new[place] = len(kept)
            kept.append(Instruction(kind, tuple([new[a] for a in args]), value))
    found = tuple(Output(output.shape, tuple([new[p] for p in output.places])) for output in outputs)
    return Program(input_shapes, tuple(kept), found)
