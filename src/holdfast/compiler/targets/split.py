"""A program as a target writes it: short functions that are called in order, and where each finds its numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from holdfast.compiler.cut import Pieces, by_length
from holdfast.compiler.program import Program

# Longer functions are cut: a compiler's cost grows faster than their length, and so do its spills.
LONGEST = 1000


class Access(NamedTuple):
    """How a function finds the numbers of one array.

    Attributes:
        step: doubles from one number to the next.
        splat: one double for all lanes, rather than a vector of them.
    """

    step: int = 1
    splat: bool = False


class Number(NamedTuple):
    """Where a function finds a number, or leaves it.

    Attributes:
        pointer: to an array.
        place: there.
        access: how the array lies.
    """

    pointer: str
    place: int
    access: Access


class Part(NamedTuple):
    """One of the functions.

    Attributes:
        program: what it computes.
        sources: where its inputs are, one number after the other.
        targets: per output, where its numbers go; those that two outputs have go there once.
    """

    program: Program
    sources: Sequence[Number]
    targets: Sequence[Sequence[Number]]

    @property
    def wanted(self) -> dict[int, dict[Number, str]]:
        """By place in the program, where its value goes, and a name for each."""
        found: dict[int, dict[Number, str]] = {}
        for k, output in enumerate(self.program.outputs):
            for e, place in enumerate(output.places):
                if place >= 0:
                    found.setdefault(place, {}).setdefault(self.targets[k][e], f"o{k}.{e}")
        return found


class SplitProgram(NamedTuple):
    """A program in parts, all of which have the same parameters.

    Attributes:
        parts: in the order in which they run.
        reads: which of the program's inputs are parameters,
        writes: and which of its outputs.
        scratch: how many numbers the scratch memory has, the last parameter; 0 without it.
    """

    parts: list[Part]
    reads: tuple[int, ...]
    writes: tuple[int, ...]
    scratch: int

    @property
    def parameters(self) -> list[str]:
        """The pointers that each part takes: the inputs that are read, the outputs, and scratch memory."""
        pointers = [f"in{k}" for k in self.reads] + [f"out{k}" for k in self.writes]
        return [*pointers, "scratch"] if self.scratch else pointers


def split(
    program: Program, lanes: int, inputs: Sequence[Access], outputs: Sequence[Access], longest: int = LONGEST
) -> SplitProgram:
    """Return a program in parts: in one, or several if it is long.

    Args:
        program: what is computed.
        lanes: how many systems or items side by side.
        inputs: how each input array lies in memory.
        outputs: the same of the outputs.
        longest: operations in one part.
    """
    pieces = by_length(program, longest)
    sizes = [math.prod(shape) for shape in program.input_shapes]
    of_array = [k for k, size in enumerate(sizes) for _ in range(size)]
    used = {of_array[a] for p in pieces.programs for i in p.instructions for a in i.args if a < len(of_array)}
    used |= {of_array[p] for o in program.outputs for p in o.places if 0 <= p < len(of_array)}
    kept = _kept(pieces, lanes, outputs)
    given = [Number(f"in{k}", e, access) for k, access in enumerate(inputs) for e in range(sizes[k])]
    results = [
        [Number(f"out{j}", e, a) for e in range(math.prod(o.shape))]
        for j, (o, a) in enumerate(zip(program.outputs, outputs, strict=True))
    ]
    parts = []
    for k, part in enumerate(pieces.programs):
        start = sum(pieces.memory[:k])
        own = kept[start : start + pieces.memory[k]]
        parts.append(Part(part, [*given, *kept[:start]], [*results, own]))
    writes = tuple(k for k, o in enumerate(program.outputs) if o.places)
    return SplitProgram(parts, tuple(sorted(used)), writes, sum(number.pointer == "scratch" for number in kept))


def _kept(pieces: Pieces, lanes: int, outputs: Sequence[Access]) -> list[Number]:
    """Return where the parts keep what later ones need: in a result, if it is one, else in scratch memory."""
    found: list[Number] = []
    count = 0
    for part in pieces.programs:
        *results, memory = part.outputs
        known = {
            place: Number(f"out{k}", e, outputs[k])
            for k, output in enumerate(results)
            for e, place in enumerate(output.places)
        }
        for place in memory.places:
            found.append(known.get(place) or Number("scratch", count, Access(lanes)))
            count += place not in known
    return found
