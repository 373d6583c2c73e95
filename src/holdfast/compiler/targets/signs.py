"""Find negatives whose sign a compiler would move into an fma, where it is wrong if the sum is zero."""

from __future__ import annotations

from holdfast.compiler.program import Program

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
