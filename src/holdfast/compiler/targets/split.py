"""Split a program into short functions that are called in order, and assign the memory that each reads and writes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from holdfast.compiler.cut import Pieces, by_length
from holdfast.compiler.order import ordered
from holdfast.compiler.program import Program

# Longer functions are split, because compile time and register spills grow faster than the length of a function.
LONGEST_PART = 1000

# Groups of systems in lanes take turns after each function. If functions are short, a processor, which looks ahead by a
# few hundred instructions, computes one group while operations of the other wait for the ones before.
# Compile time grows with the number of parts, so these are longer if there would be too many.
LONGEST_OF_GROUPS, _MOST_OF_GROUPS = 150, 16


class Access(NamedTuple):
    """How a function accesses the numbers of one array.

    Attributes:
        step: the distance from one number to the next [doubles].
        splat: whether all lanes read the same double, rather than a vector.
    """

    step: int = 1
    splat: bool = False


class NumberPlace(NamedTuple):
    """The location of a number that a function reads or writes.

    Attributes:
        pointer: the name of the pointer to an array.
        place: the index of the number in that array.
        access: how the array is accessed.
    """

    pointer: str
    place: int
    access: Access


class SplitPart(NamedTuple):
    """One of the functions.

    Attributes:
        program: the program that it computes.
        sources: the location of every input number, in order.
        targets: for every output, the locations to which its numbers are written.
    """

    program: Program
    sources: Sequence[NumberPlace]
    targets: Sequence[Sequence[NumberPlace]]

    @property
    def wanted(self) -> dict[int, dict[NumberPlace, str]]:
        """The locations to which each value is written, by place in the program; each location once, with a name."""
        found: dict[int, dict[NumberPlace, str]] = {}
        for k, output in enumerate(self.program.outputs):
            for e, place in enumerate(output.places):
                if place >= 0:
                    found.setdefault(place, {}).setdefault(self.targets[k][e], f"o{k}.{e}")
        return found


class SplitProgram(NamedTuple):
    """A program in parts, all of which have the same parameters.

    Attributes:
        parts: the parts in the order in which they run.
        reads: the indices of the program's inputs to which the functions take pointers.
        writes: the indices of the program's outputs to which the functions take pointers.
        scratch: the number of values in scratch memory, which is the last parameter; 0 if there is none.
    """

    parts: list[SplitPart]
    reads: tuple[int, ...]
    writes: tuple[int, ...]
    scratch: int

    @property
    def parameters(self) -> list[str]:
        """The pointers that each part takes: the inputs that are read, the outputs, and scratch memory."""
        pointers = [f"in{k}" for k in self.reads] + [f"out{k}" for k in self.writes]
        return [*pointers, "scratch"] if self.scratch else pointers


def split(
    program: Program, lanes: int, inputs: Sequence[Access], outputs: Sequence[Access], turns: bool = False
) -> SplitProgram:
    """Return a program as one part, or as several parts if it is long.

    Args:
        program: the program.
        lanes: how many systems or items are computed side by side.
        inputs: how each input array is accessed.
        outputs: how each output array is accessed.
        turns: whether groups of systems take turns after each part.
    """
    longest = LONGEST_PART
    if turns:
        longest = min(longest, max(LONGEST_OF_GROUPS, len(program.instructions) // _MOST_OF_GROUPS))
    pieces = by_length(program, longest)
    pieces = pieces._replace(programs=tuple([ordered(part) for part in pieces.programs]))
    sizes = [math.prod(shape) for shape in program.input_shapes]
    of_array = [k for k, size in enumerate(sizes) for _ in range(size)]
    used = {of_array[a] for p in pieces.programs for i in p.instructions for a in i.args if a < len(of_array)}
    used |= {of_array[p] for o in program.outputs for p in o.places if 0 <= p < len(of_array)}
    kept = _kept(pieces, lanes, outputs)
    given = [NumberPlace(f"in{k}", e, access) for k, access in enumerate(inputs) for e in range(sizes[k])]
    results = [
        [NumberPlace(f"out{j}", e, a) for e in range(math.prod(o.shape))]
        for j, (o, a) in enumerate(zip(program.outputs, outputs, strict=True))
    ]
    parts = []
    for k, part in enumerate(pieces.programs):
        start = sum(pieces.memory[:k])
        own = kept[start : start + pieces.memory[k]]
        parts.append(SplitPart(part, [*given, *kept[:start]], [*results, own]))
    writes = tuple(k for k, o in enumerate(program.outputs) if o.places)
    scratch = max([0, *(number.place + 1 for number in kept if number.pointer == "scratch")])
    return SplitProgram(parts, tuple(sorted(used)), writes, scratch)


def _kept(pieces: Pieces, lanes: int, outputs: Sequence[Access]) -> list[NumberPlace]:
    """Return the locations of values that later parts need: in a result if the value is one, else in scratch memory.

    A place in scratch memory is used again by parts after the last one that needs its value.
    """
    first, last = pieces.programs[0].input_size, [0] * sum(pieces.memory)  # the last part that needs each value
    for k, part in enumerate(pieces.programs):
        used = {a for i in part.instructions for a in i.args} | {p for o in part.outputs for p in o.places}
        for a in used:
            if first <= a < part.input_size:
                last[a - first] = k
    found: list[NumberPlace] = []
    free: list[int] = []
    taken: list[list[int]] = [[] for _ in pieces.programs]  # places by the part after which they are free
    count = 0
    for k, part in enumerate(pieces.programs):
        *results, memory = part.outputs
        known = {
            place: NumberPlace(f"out{j}", e, outputs[j])
            for j, output in enumerate(results)
            for e, place in enumerate(output.places)
            if place >= 0
        }
        for place in memory.places:
            if place not in known:
                if not free:
                    free.append(count)
                    count += 1
                taken[last[len(found)]].append(free[-1])
                known[place] = NumberPlace("scratch", free.pop(), Access(lanes))
            found.append(known[place])
        free += taken[k]
    return found


_MOVED_THROUGH = frozenset({"negate", "multiply", "divide", "select"})  # -(x y) is (-x) y, and so on, exactly


def signs_to_keep(program: Program, of_operands: bool) -> set[int]:
    """Return the places of negatives of an fma, or of a product, quotient or choice that contains one.

    Processors have an instruction for (-a) b + (-c): vfnmsub, or fnmadd. GCC uses it for -(a b + c) too, and so does
    LLVM on ARM, although the signs of zeros differ: -(1 + (-1)) is -0, but -1 + 1 is +0. What these negatives are of
    must therefore be computed before its sign is changed.

    Args:
        program: the program.
        of_operands: whether negatives that are only operands of other fma are included.
    """
    fused: list[bool] = []  # whether the sign of a result could be moved into an fma
    wanted = {place for output in program.outputs for place in output.places}
    for kind, args, _ in program.instructions:
        fused.append(kind == "fma" or (kind in _MOVED_THROUGH and any(fused[a] for a in args)))
        if of_operands or kind != "fma":
            wanted.update(args)
    return {p for p in wanted if p >= 0 and program.instructions[p].kind == "negate" and fused[p]}
