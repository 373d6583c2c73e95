"""Products and the sums that take them up become one operation, rounded once: fma(a, b, c) = a b + c."""

from __future__ import annotations

from holdfast.compiler.program import Output, Program, pruned


def fuse(program: Program) -> Program:
    """Return the program with fma instructions; their number is in `counts`.

    A product that is used once, by a sum or difference, goes into it; of two such products the
    later one. This fixes the result's bits: the machine never fuses on its own.
    """
    instructions = program.instructions
    uses = [0] * len(instructions)
    for _, args, _ in instructions:
        for a in args:
            uses[a] += 1
    for output in program.outputs:
        for place in output.places:
            uses[place] += 1
    alone = [kind == "multiply" and n == 1 for (kind, _, _), n in zip(instructions, uses, strict=True)]
    writer = _Writer()
    new: list[int] = []
    for kind, args, value in instructions:
        if kind not in ("add", "subtract") or not (alone[args[0]] or alone[args[1]]):
            new.append(writer.write(kind, tuple([new[a] for a in args]), value))
            continue
        product = 1 if alone[args[1]] else 0
        a, b = (new[x] for x in instructions[args[product]].args)
        c = new[args[1 - product]]
        if kind == "subtract":
            if product == 0:
                c = writer.negative(c)
            elif writer.is_constant(b):
                b = writer.negative(b)
            else:
                a = writer.negative(a)
        new.append(writer.write("fma", (a, b, c)))
    outputs = [Output(output.shape, tuple([new[p] for p in output.places])) for output in program.outputs]
    return pruned(program.input_shapes, writer.instructions, outputs)


class _Writer:
    """Writes instructions one after the other; negatives and constants once each."""

    def __init__(self) -> None:
        self.instructions: list[tuple[str, tuple[int, ...], float]] = []
        self._known: dict[object, int] = {}

    def write(self, kind: str, args: tuple[int, ...], value: float = 0.0) -> int:
        if kind in ("constant", "negate"):
            key = (kind, value.hex()) if kind == "constant" else (kind, args)
            if key in self._known:
                return self._known[key]
            self._known[key] = len(self.instructions)
        self.instructions.append((kind, args, value))
        return len(self.instructions) - 1

    def is_constant(self, place: int) -> bool:
        return self.instructions[place][0] == "constant"

    def negative(self, place: int) -> int:
        kind, args, value = self.instructions[place]
        if kind == "negate":
            return args[0]
        return self.write("constant", (), -value) if kind == "constant" else self.write("negate", (place,))
