"""The meaning of a program: one number after the other, in Python. The machine code must agree bit for bit."""

from __future__ import annotations

import numpy as np

from holdfast.compiler.arithmetic import OPERATIONS
from holdfast.compiler.errors import CompileError
from holdfast.compiler.expand import lowered
from holdfast.compiler.program import Program


def interpret(program: Program, *inputs: object, fused: bool = True) -> tuple[np.ndarray, ...]:
    """Return what a program computes for one system.

    Args:
        program: the program.
        inputs: an array for each of its input shapes.
        fused: whether products go into sums first (`fuse`), as `compile_program` does.
    """
    program = lowered(program, fused)
    arrays = [np.asarray(x, dtype=float) for x in inputs]
    if tuple(a.shape for a in arrays) != program.input_shapes:
        raise CompileError(
            f"interpret: expected arrays of shapes {program.input_shapes}, got {tuple(a.shape for a in arrays)}"
        )
    given = [float(x) for a in arrays for x in a.flat]
    values: list[float] = []
    for kind, args, value in program.instructions:
        if kind == "input":
            value = given[len(values)]
        elif kind != "constant":
            value = OPERATIONS[kind](*(values[a] for a in args))
        values.append(value)
    return tuple(np.array([values[p] for p in places], dtype=float).reshape(shape) for shape, places in program.outputs)
