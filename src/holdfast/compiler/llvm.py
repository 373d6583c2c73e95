"""A program as LLVM's text: one straight line of operations, on numbers or on `lanes` systems at a time.

No fast-math flag is ever written, so LLVM neither fuses nor reorders: the bits are the interpreter's.
"""

from __future__ import annotations

import math
import struct

from holdfast.compiler.batch_loop import batch_function
from holdfast.compiler.program import Program

_BINARY = {"add": "fadd", "subtract": "fsub", "multiply": "fmul", "divide": "fdiv"}
_INTRINSICS = {"absolute": "fabs", "sqrt": "sqrt", "fma": "fma"}
_ARITY = {"absolute": 1, "sqrt": 1, "fma": 3}
_COMPARISONS = {"less": "olt", "less_equal": "ole"}

# LLVM schedules each basic block as a whole, at more than linear cost and into more spills: four arms
# compile 1.5 times faster in blocks of this many instructions, and run 9 % faster.
_BLOCK = 1000


def single_module(program: Program) -> str:
    """Return the module of `void single(double *in, double *out)`, all arrays one after the other."""
    return "\n".join([*_declarations(1), *_body("single", "", program, 1)])


def batch_module(program: Program, lanes: int) -> str:
    """Return the module of `batch`, which runs blocks of `lanes` systems (see `batch_loop`)."""
    inputs = [math.prod(shape) for shape in program.input_shapes]
    outputs = [len(output.places) for output in program.outputs]
    return "\n".join(
        [
            *_declarations(lanes),
            "declare i64 @llvm.smin.i64(i64, i64)",
            *_body("block", "internal ", program, lanes),
            *batch_function(inputs, outputs, lanes),
        ]
    )


def number_type(lanes: int) -> str:
    """Return LLVM's type of one value."""
    return "double" if lanes == 1 else f"<{lanes} x double>"


def _truth_type(lanes: int) -> str:
    return "i1" if lanes == 1 else f"<{lanes} x i1>"


def _suffix(lanes: int) -> str:
    return "f64" if lanes == 1 else f"v{lanes}f64"


def _declarations(lanes: int) -> list[str]:
    T = number_type(lanes)
    return [
        f"declare {T} @llvm.{_INTRINSICS[kind]}.{_suffix(lanes)}({', '.join([T] * n)})" for kind, n in _ARITY.items()
    ]


def _constant(value: float, lanes: int) -> str:
    bits = f"0x{struct.unpack('<Q', struct.pack('<d', value))[0]:016X}"
    return bits if lanes == 1 else "<" + ", ".join([f"double {bits}"] * lanes) + ">"


def _body(name: str, linkage: str, program: Program, lanes: int) -> list[str]:
    """Return a function that reads each input where it is first needed and stores each result at once."""
    T, truth, suffix = number_type(lanes), _truth_type(lanes), _suffix(lanes)
    lines = [f"define {linkage}void @{name}(ptr noalias %in, ptr noalias %out) noinline nounwind {{"]
    lines.append("  %never = icmp eq ptr %in, %out  ; keeps LLVM from joining the blocks again")
    names: dict[int, str] = {}
    wanted: dict[int, list[int]] = {}
    for slot, place in enumerate(p for output in program.outputs for p in output.places):
        wanted.setdefault(place, []).append(slot)

    def read(place: int) -> str:
        kind, _, value = program.instructions[place]
        if place not in names and kind == "constant":
            names[place] = _constant(value, lanes)
        elif place not in names:  # an input
            lines.append(f"  %i{place} = getelementptr {T}, ptr %in, i64 {place}")
            lines.append(f"  %v{place} = load {T}, ptr %i{place}, align {8 * lanes}")
            names[place] = f"%v{place}"
        return names[place]

    for place, (kind, args, _) in enumerate(program.instructions):
        if place % _BLOCK == _BLOCK - 1:
            lines += [f"  br i1 %never, label %end, label %b{place}", f"b{place}:"]
        if kind not in ("input", "constant"):
            x = [read(a) for a in args]
            if kind in _BINARY:
                text = f"{_BINARY[kind]} {T} {x[0]}, {x[1]}"
            elif kind in _INTRINSICS:
                text = f"call {T} @llvm.{_INTRINSICS[kind]}.{suffix}({', '.join(f'{T} {a}' for a in x)})"
            elif kind in _COMPARISONS:
                text = f"fcmp {_COMPARISONS[kind]} {T} {x[0]}, {x[1]}"
            elif kind == "select":
                text = f"select {truth} {x[0]}, {T} {x[1]}, {T} {x[2]}"
            else:
                assert kind == "negate", kind
                text = f"fneg {T} {x[0]}"
            lines.append(f"  %v{place} = {text}")
            names[place] = f"%v{place}"
        for slot in wanted.get(place, ()):
            result = read(place)
            lines.append(f"  %o{slot} = getelementptr {T}, ptr %out, i64 {slot}")
            lines.append(f"  store {T} {result}, ptr %o{slot}, align {8 * lanes}")
    return [*lines, "  br label %end", "end:", "  ret void", "}"]
