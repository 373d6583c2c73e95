"""The order of a program's instructions: the fewer numbers are in use at a time, the fewer have to leave registers."""

from __future__ import annotations

from holdfast.compiler.program import Instruction, Output, Program

_REGISTERS = 32  # as many as processors have at most


def is_crowded(program: Program) -> bool:
    """Return whether more numbers are in use, on average, than there are registers."""
    return sum(program.live_numbers) > _REGISTERS * len(program.live_numbers)


def ordered(program: Program) -> Program:
    """Return a crowded program in depth-first order if fewer numbers are in use then, otherwise the program itself.

    Operands are computed right before the instruction that needs them, one after the other, and results in turn.
    Every instruction keeps its operands, so the bits are the same.
    """
    if not is_crowded(program):
        return program
    first, places = program.input_size, depth_first(program)
    new = [*range(first), *([-1] * (len(program.instructions) - first))]
    for k, place in enumerate(places, first):
        new[place] = k
    instructions = list(program.instructions[:first])
    for place in places:
        kind, args, value = program.instructions[place]
        instructions.append(Instruction(kind, tuple([new[a] for a in args]), value))
    outputs = [Output(o.shape, tuple([new[p] if p >= 0 else -1 for p in o.places])) for o in program.outputs]
    other = Program(program.input_shapes, tuple(instructions), tuple(outputs))
    return min(program, other, key=lambda choice: sum(choice.live_numbers))


def depth_first(program: Program) -> list[int]:
    """Return the places of the instructions that results need, inputs excepted, in depth-first order."""
    instructions, first = program.instructions, program.input_size
    found: list[int] = []
    begun = bytearray(b"\1" * first + b"\0" * (len(instructions) - first))
    for result in sorted({place for output in program.outputs for place in output.places if place >= first}):
        waiting = [result]
        while waiting:
            place = waiting.pop()
            if place < 0:  # its operands come before it by now
                found.append(~place)
            elif not begun[place]:
                begun[place] = 1
                waiting.append(~place)
                waiting += instructions[place].args[::-1]
    return found
