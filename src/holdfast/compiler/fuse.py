"""Products and the sums that take them up become one operation, rounded once: fma(a, b, c) = a b + c."""

from __future__ import annotations

from collections import Counter

from holdfast.compiler.program import Instruction, Output, Program, pruned


def fuse(program: Program) -> Program:
    """Return the program with fma instructions; their number is in `counts`.

    A product that is used once, by a sum or difference, goes into it; of two such products the
    later one. This fixes the result's bits: the machine never fuses on its own.
    """
    uses = Counter(a for i in program.instructions for a in i.args)
    uses.update(place for output in program.outputs for place in output.places)
    writer = _Writer()
    new: list[int] = []
    for instruction in program.instructions:
        product = next(
            (
                k
                for k in (1, 0)
                if instruction.kind in ("add", "subtract")
                and program.instructions[instruction.args[k]].kind == "multiply"
                and uses[instruction.args[k]] == 1
            ),
            None,
        )
        if product is None:
            new.append(writer.write(instruction.kind, tuple(new[a] for a in instruction.args), instruction.value))
            continue
        a, b = (new[x] for x in program.instructions[instruction.args[product]].args)
        c = new[instruction.args[1 - product]]
        if instruction.kind == "subtract":
            if product == 0:
                c = writer.negative(c)
            elif writer.is_constant(b):
                b = writer.negative(b)
            else:
                a = writer.negative(a)
        new.append(writer.write("fma", (a, b, c)))
    outputs = [Output(output.shape, tuple(new[p] for p in output.places)) for output in program.outputs]
    return pruned(program.input_shapes, writer.instructions, outputs)


class _Writer:
    """Writes instructions one after the other; negatives and constants once each."""

    def __init__(self) -> None:
        self.instructions: list[Instruction] = []
        self._known: dict[object, int] = {}

    def write(self, kind: str, args: tuple[int, ...], value: float = 0.0) -> int:
        key = (kind, value.hex()) if kind == "constant" else (kind, args)
        if kind in ("constant", "negate"):
            if key in self._known:
                return self._known[key]
            self._known[key] = len(self.instructions)
        self.instructions.append(Instruction(kind, args, value))
        return len(self.instructions) - 1

    def is_constant(self, place: int) -> bool:
        return self.instructions[place].kind == "constant"

    def negative(self, place: int) -> int:
        kind, args, value = self.instructions[place]
        if kind == "negate":
            return args[0]
        return self.write("constant", (), -value) if kind == "constant" else self.write("negate", (place,))
