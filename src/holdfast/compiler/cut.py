"""A program taken apart: pieces that run one after the other and keep in memory what later ones need."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from holdfast.compiler.arithmetic import TRUTHS
from holdfast.compiler.program import Instruction, Output, Program

# Made again wherever they are used: signs cost nothing there, and truth values have no place in memory.
_MADE_AGAIN = frozenset({"constant", "negate", "absolute", *TRUTHS})


class Pieces(NamedTuple):
    """A program in pieces.

    Piece k takes the program's inputs and then the memories of the pieces before it; it returns
    its results and then its own memory. A place of -1 in a result is another piece's to write.

    Attributes:
        programs: the pieces.
        memory: how many numbers each leaves to the later ones.
    """

    programs: tuple[Program, ...]
    memory: tuple[int, ...]


def cut(program: Program, piece: Sequence[int], outputs: Sequence[Sequence[Output]]) -> Pieces:
    """Return the program in pieces.

    Args:
        program: the program.
        piece: for every instruction the piece that computes it, not before its operands are there;
            those of inputs and constants do not matter.
        outputs: for every piece its results, as places in the program.
    """
    count = len(outputs)
    kept: list[list[int]] = [[] for _ in range(count)]  # by piece: places whose values later pieces need
    seen: set[int] = set()

    def keep(place: int, reader: int) -> None:
        """Note what `reader` needs of earlier pieces to have the value at `place`."""
        stack = [place]
        while stack:
            p = stack.pop()
            kind, args, _ = program.instructions[p]
            if kind in _MADE_AGAIN:
                stack.extend(args)
            elif kind != "input" and piece[p] < reader and p not in seen:
                seen.add(p)
                kept[piece[p]].append(p)

    for p, (kind, args, _) in enumerate(program.instructions):
        if kind not in _MADE_AGAIN:
            for a in args:
                keep(a, piece[p])
    for k, results in enumerate(outputs):
        for output in results:
            for p in output.places:
                if p >= 0:
                    keep(p, k)
    for places in kept:
        places.sort()
    memory = tuple(len(places) for places in kept)
    programs = tuple(_piece(program, piece, k, kept, outputs[k]) for k in range(count))
    return Pieces(programs, memory)


def _piece(
    program: Program, piece: Sequence[int], k: int, kept: list[list[int]], outputs: Sequence[Output]
) -> Program:
    instructions = [i for i in program.instructions[: program.input_size]]
    new = {p: p for p in range(len(instructions))}
    for j in range(k):
        for p in kept[j]:
            new[p] = len(instructions)
            instructions.append(Instruction("input"))

    def place_of(p: int) -> int:
        """Return where the value is in the piece, made again if need be."""
        stack = [p]
        while stack:
            q = stack[-1]
            if q in new:
                stack.pop()
                continue
            kind, args, value = program.instructions[q]
            waiting = [a for a in args if a not in new]
            if waiting:
                stack.extend(waiting)
                continue
            assert kind in _MADE_AGAIN or piece[q] == k, (kind, piece[q], k)
            new[q] = len(instructions)
            instructions.append(Instruction(kind, tuple(new[a] for a in args), value))
            stack.pop()
        return new[p]

    for p, (kind, _, _) in enumerate(program.instructions):
        if kind not in _MADE_AGAIN and kind != "input" and piece[p] == k:
            place_of(p)
    found = [Output(o.shape, tuple(place_of(p) if p >= 0 else -1 for p in o.places)) for o in outputs]
    found.append(Output((len(kept[k]),), tuple(place_of(p) for p in kept[k])))
    shapes = (*program.input_shapes, *((len(kept[j]),) for j in range(k)))
    return Program(shapes, tuple(instructions), tuple(found))


def by_phase(program: Program, input_phases: Sequence[int], results: Sequence[int]) -> Pieces:
    """Return the program cut into phases: everything is computed as early as its inputs are there.

    Args:
        program: the program.
        input_phases: when each input array becomes known.
        results: how many of the outputs belong to each phase, in order.
    """
    piece: list[int] = []
    known = [phase for phase, shape in zip(input_phases, program.input_shapes, strict=True) for _ in range(_size(shape))]
    for p, (kind, args, _) in enumerate(program.instructions):
        piece.append(known[p] if kind == "input" else max((piece[a] for a in args), default=0))
    outputs, start = [], 0
    for n in results:
        outputs.append(program.outputs[start : start + n])
        start += n
    return cut(program, piece, outputs)


def by_length(program: Program, length: int) -> Pieces:
    """Return the program cut after every `length` operations, each result written where it is computed."""
    first = program.input_size
    count = max(1, -(-(len(program.instructions) - first) // length))
    piece = [max(0, p - first) // length for p in range(len(program.instructions))]
    for p, (kind, args, _) in enumerate(program.instructions):
        if kind in _MADE_AGAIN and args:
            piece[p] = max(piece[a] for a in args)
    outputs = [
        tuple(Output(o.shape, tuple(p if piece[p] == k else -1 for p in o.places)) for o in program.outputs)
        for k in range(count)
    ]
    return cut(program, piece, outputs)


def _size(shape: Sequence[int]) -> int:
    size = 1
    for n in shape:
        size *= n
    return size
