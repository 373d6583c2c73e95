"""Cut a program into pieces that run one after the other and keep in memory the values that later pieces need."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from holdfast.compiler.arithmetic import TRUTHS
from holdfast.compiler.program import Instruction, Output, Program

# These are recomputed in every piece that uses them: signs are free, and truth values cannot be stored in memory.
_MADE_AGAIN = frozenset({"constant", "negate", "absolute", *TRUTHS})


class Pieces(NamedTuple):
    """A program in pieces.

    Piece k takes the program's inputs and then the memories of the pieces before it; it returns
    its results and then its own memory. A place of -1 marks an entry of a result that another piece writes.

    Attributes:
        programs: the pieces, in the order in which they run.
        memory: how many numbers each piece stores for the later ones.
    """

    programs: tuple[Program, ...]
    memory: tuple[int, ...]


def cut(program: Program, piece: Sequence[int], outputs: Sequence[Sequence[Output]]) -> Pieces:
    """Return the program cut into given pieces.

    Args:
        program: the program.
        piece: for every instruction the index of the piece that computes it, which must not be smaller than that of
            any operand. The entries of inputs and constants are ignored.
        outputs: the results of every piece, as places in the program.
    """
    count, first = len(outputs), program.input_size
    roots = _roots(program)
    kept: list[list[int]] = [[] for _ in range(count)]  # by piece: places whose values later pieces need
    own: list[list[int]] = [[] for _ in range(count)]  # by piece: places that it computes
    seen: set[int] = set()

    def keep(place: int, reader: int) -> None:
        """Mark the values that earlier pieces must store so that piece `reader` has the value at `place`."""
        for p in roots[place]:
            if piece[p] < reader and p not in seen:
                seen.add(p)
                kept[piece[p]].append(p)

    for p, (kind, args, _) in enumerate(program.instructions):
        if p >= first and kind not in _MADE_AGAIN:
            own[piece[p]].append(p)
            for a in args:
                keep(a, piece[p])
    for k, results in enumerate(outputs):
        for output in results:
            for p in output.places:
                if p >= 0:
                    keep(p, k)
    memory = tuple(len(places) for places in kept)
    before = {}  # the index of a stored value among the inputs of later pieces, which is the same in each
    for places in kept:
        places.sort()
        for p in places:
            before[p] = first + len(before)
    shapes = (*program.input_shapes, *((size,) for size in memory))
    programs = []
    for k in range(count):
        inputs = program.instructions[:first] + (Instruction("input"),) * sum(memory[:k])
        writer = _Piece(program, piece, k, before, list(inputs))
        for p in own[k]:
            writer.place(p)
        results = (*outputs[k], Output((memory[k],), tuple(kept[k])))
        found = tuple(Output(o.shape, tuple([writer.place(p) if p >= 0 else -1 for p in o.places])) for o in results)
        programs.append(Program(shapes[: len(program.input_shapes) + k], tuple(writer.instructions), found))
    return Pieces(tuple(programs), memory)


def _roots(program: Program) -> list[tuple[int, ...]]:
    """Return for every place the stored values from which a later piece obtains it: in most cases the place itself."""
    roots: list[tuple[int, ...]] = []
    for p, (kind, args, _) in enumerate(program.instructions):
        if kind in _MADE_AGAIN:
            roots.append(tuple(r for a in args for r in roots[a]))
        else:
            roots.append(() if kind == "input" else (p,))
    return roots


class _Piece:
    """Writes the instructions of one piece."""

    def __init__(
        self, program: Program, piece: Sequence[int], k: int, before: dict[int, int], instructions: list[Instruction]
    ) -> None:
        self.program, self.piece, self.k, self.before, self.instructions = program, piece, k, before, instructions
        self.new: dict[int, int] = {}

    def place(self, p: int) -> int:
        """Return the place of a value in this piece; write its instruction if the piece has to compute it."""
        new = self.new
        if p in new:
            return new[p]
        kind, args, value = self.program.instructions[p]
        if kind == "input":
            return p
        if kind not in _MADE_AGAIN and self.piece[p] < self.k:
            return self.before[p]
        places = tuple([new[a] if a in new else self.place(a) for a in args])
        new[p] = len(self.instructions)
        self.instructions.append(Instruction(kind, places, value))
        return new[p]


def by_phase(program: Program, input_phases: Sequence[int], results: Sequence[int]) -> Pieces:
    """Return the program cut into phases; every value is computed in the first phase in which its inputs are known.

    Args:
        program: the program.
        input_phases: the phase in which each input array becomes known.
        results: how many of the outputs belong to each phase, in order.
    """
    piece: list[int] = []
    sizes = [math.prod(shape) for shape in program.input_shapes]
    known = [phase for phase, size in zip(input_phases, sizes, strict=True) for _ in range(size)]
    for p, (kind, args, _) in enumerate(program.instructions):
        latest = known[p] if kind == "input" else 0
        for a in args:
            if piece[a] > latest:
                latest = piece[a]
        piece.append(latest)
    outputs, start = [], 0
    for n in results:
        outputs.append(program.outputs[start : start + n])
        start += n
    return cut(program, piece, outputs)


def by_length(program: Program, length: int) -> Pieces:
    """Return the program in the smallest number of pieces of up to `length` instructions.

    It is cut where the fewest values are live; each result is written by the piece that computes it.
    """
    first = program.input_size
    count = max(1, -(-(len(program.instructions) - first) // length))
    if count == 1:  # `cut` would return the same program
        outputs = (*program.outputs, Output((0,), ()))
        return Pieces((Program(program.input_shapes, program.instructions, outputs),), (0,))
    cuts = _quietest(_across(program)[first:], count, length)
    piece = [bisect_right(cuts, p - first) for p in range(len(program.instructions))]
    for p, (kind, args, _) in enumerate(program.instructions):
        if kind in _MADE_AGAIN and args:
            piece[p] = max([piece[a] for a in args])
    outputs = [
        tuple(Output(o.shape, tuple(p if piece[p] == k else -1 for p in o.places)) for o in program.outputs)
        for k in range(count)
    ]
    return cut(program, piece, outputs)


def _across(program: Program) -> list[int]:
    """Return for every place how many values are live: computed before it and needed there or later."""
    last: dict[int, int] = {}
    roots = _roots(program)
    for p, (kind, args, _) in enumerate(program.instructions):
        if p >= program.input_size and kind not in _MADE_AGAIN:
            last.update((root, p) for a in args for root in roots[a])
    change = [0] * (len(program.instructions) + 1)
    for p, end in last.items():
        change[p + 1] += 1
        change[end + 1] -= 1
    return list(accumulate(change[:-1]))


def _quietest(across: Sequence[int], count: int, length: int) -> list[int]:
    """Return the places of `count - 1` cuts into parts of up to `length` with the fewest live values at all cuts.

    Dynamic programming over the place of the last cut.
    """
    size = len(across)
    least, before = np.zeros(1), 0  # the least sum so far for each place of the last cut, which is `before` or later
    chosen: list[tuple[int, list[int]]] = []
    for k in range(1, count):
        begin, end = max(k, size - (count - k) * length), min(k * length, size - count + k)
        sums, from_where = [], []
        for p in range(begin, end + 1):
            window = least[max(0, p - length - before) : p - before]
            best = int(np.argmin(window))
            from_where.append(max(before, p - length) + best)
            sums.append(across[p] + window[best])
        chosen.append((begin, from_where))
        least, before = np.array(sums), begin
    cuts: list[int] = []
    at = before + int(np.argmin(least))
    for begin, from_where in reversed(chosen):
        cuts.insert(0, at)
        at = from_where[at - begin]
    return cuts
