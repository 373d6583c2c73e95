"""A program as a function in LLVM's language: one straight line of operations, on numbers or on lanes.

No fast-math flag is ever written, so LLVM neither fuses nor reorders: the bits are the interpreter's.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NamedTuple

from holdfast.compiler.cut import Pieces, by_length
from holdfast.compiler.program import Program

_BINARY = {"add": "fadd", "subtract": "fsub", "multiply": "fmul", "divide": "fdiv"}
_FUNCTIONS = {"absolute": "fabs", "sqrt": "sqrt"}
_COMPARISONS = {"less": "olt", "less_equal": "ole"}

# Longer functions are cut: LLVM's cost grows faster than their length, and so do its spills.
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


class Function(NamedTuple):
    """A program in LLVM's language.

    Its parameters are pointers: the inputs that are read, the outputs, and scratch memory.

    Attributes:
        lines: one or more LLVM functions.
        names: of the functions, to be called in this order with the same arguments.
        reads: which of the program's inputs are parameters.
        writes: which of its outputs are.
        scratch: how many numbers the scratch memory has.
    """

    lines: list[str]
    names: list[str]
    reads: tuple[int, ...]
    writes: tuple[int, ...]
    scratch: int


def function(
    name: str, program: Program, lanes: int, inputs: Sequence[Access], outputs: Sequence[Access], longest: int = LONGEST
) -> Function:
    """Return a program as one function, or several if it is long.

    Args:
        name: of the function.
        program: what it computes.
        lanes: how many systems or items it computes side by side.
        inputs: how each input array lies in memory.
        outputs: the same of the outputs.
        longest: operations in one function.
    """
    pieces = by_length(program, longest)
    sizes = [_size(shape) for shape in program.input_shapes]
    of_array = [k for k, size in enumerate(sizes) for _ in range(size)]
    used = {of_array[a] for p in pieces.programs for i in p.instructions for a in i.args if a < len(of_array)}
    used |= {of_array[p] for o in program.outputs for p in o.places if 0 <= p < len(of_array)}
    reads = tuple(sorted(used))
    writes = tuple(k for k, o in enumerate(program.outputs) if o.places)
    kept = _kept(pieces, lanes, outputs)
    scratch = sum(number.pointer == "%scratch" for number in kept)
    lines, names = [], []
    parameters = [f"ptr noalias %in{k}" for k in reads] + [f"ptr noalias %out{k}" for k in writes]
    if scratch:
        parameters.append("ptr noalias %scratch")
    given = [Number(f"%in{k}", e, access) for k, access in enumerate(inputs) for e in range(sizes[k])]
    for k, part in enumerate(pieces.programs):
        names.append(f"{name}.{k}")
        start = sum(pieces.memory[:k])
        results = [
            [Number(f"%out{j}", e, a) for e in range(_size(o.shape))]
            for j, (o, a) in enumerate(zip(program.outputs, outputs, strict=True))
        ]
        lines.append(f"define internal void @{name}.{k}({', '.join(parameters)}) noinline nounwind {{")
        lines += _body(part, lanes, [*given, *kept[:start]], [*results, kept[start : start + pieces.memory[k]]])
        lines += ["  ret void", "}"]
    return Function(lines, names, reads, writes, scratch)


def _kept(pieces: Pieces, lanes: int, outputs: Sequence[Access]) -> list[Number]:
    """Return where the pieces keep what later ones need: in a result, if it is one, else in scratch memory."""
    found: list[Number] = []
    count = 0
    for part in pieces.programs:
        *results, memory = part.outputs
        known = {
            place: Number(f"%out{k}", e, outputs[k])
            for k, output in enumerate(results)
            for e, place in enumerate(output.places)
        }
        for place in memory.places:
            found.append(known.get(place) or Number("%scratch", count, Access(lanes)))
            count += place not in known
    return found


def declarations(lanes: int) -> list[str]:
    """Return the declarations of what functions on so many lanes call."""
    T = number_type(lanes)
    functions = [f"declare {T} @llvm.{name}.{_suffix(lanes)}({T})" for name in _FUNCTIONS.values()]
    return [*functions, f"declare {T} @llvm.fma.{_suffix(lanes)}({T}, {T}, {T})"]


def number_type(lanes: int) -> str:
    """Return LLVM's type of one value."""
    return "double" if lanes == 1 else f"<{lanes} x double>"


def constant(value: float, lanes: int) -> str:
    """Return a number by its bits, in every lane."""
    bits = f"0x{struct.unpack('<Q', struct.pack('<d', value))[0]:016X}"
    return bits if lanes == 1 else f"splat (double {bits})"


def splat(name: str, scalar: str, lanes: int) -> list[str]:
    """Return the lines that make `name` a vector of one number."""
    T = number_type(lanes)
    return [
        f"  {name}.one = insertelement {T} poison, double {scalar}, i64 0",
        f"  {name} = shufflevector {T} {name}.one, {T} poison, <{lanes} x i32> zeroinitializer",
    ]


def _truth_type(lanes: int) -> str:
    return "i1" if lanes == 1 else f"<{lanes} x i1>"


def _suffix(lanes: int) -> str:
    return "f64" if lanes == 1 else f"v{lanes}f64"


def _body(program: Program, lanes: int, sources: Sequence[Number], targets: Sequence[Sequence[Number]]) -> list[str]:
    """Return the operations; each input is read where it is first needed, each result stored at once.

    Args:
        program: the program.
        lanes: values side by side.
        sources: where the inputs are, one number after the other.
        targets: per output, where its numbers go; those that two outputs have go there once.
    """
    T, truth, suffix = number_type(lanes), _truth_type(lanes), _suffix(lanes)
    lines: list[str] = []
    names: dict[int, str] = {}
    first_operation = program.input_size
    wanted: dict[int, dict[Number, str]] = {}
    for k, output in enumerate(program.outputs):
        for e, place in enumerate(output.places):
            if place >= 0:
                wanted.setdefault(place, {}).setdefault(targets[k][e], f"%o{k}.{e}")

    def read(place: int) -> str:
        if place in names:
            return names[place]
        kind, _, value = program.instructions[place]
        if kind == "constant":
            names[place] = constant(value, lanes)
            return names[place]
        assert kind == "input"
        pointer, number, access = sources[place]
        lines.append(f"  %i{place} = getelementptr double, ptr {pointer}, i64 {number * access.step}")
        if access.splat and lanes > 1:
            lines.append(f"  %s{place} = load double, ptr %i{place}, align 8")
            lines.extend(splat(f"%v{place}", f"%s{place}", lanes))
        else:
            lines.append(f"  %v{place} = load {T}, ptr %i{place}, align {8 * lanes}")
        names[place] = f"%v{place}"
        return names[place]

    def store(place: int) -> None:
        for (pointer, number, access), at in wanted[place].items():
            result = read(place)
            lines.append(f"  {at} = getelementptr double, ptr {pointer}, i64 {number * access.step}")
            lines.append(f"  store {T} {result}, ptr {at}, align {8 * lanes}")

    for place in sorted(p for p in wanted if p < first_operation):
        store(place)
    for place in range(first_operation, len(program.instructions)):
        kind, args, _ = program.instructions[place]
        if kind != "constant":
            x = [names.get(a) or read(a) for a in args]
            name = names[place] = f"%v{place}"
            if kind in _BINARY:
                text = f"{_BINARY[kind]} {T} {x[0]}, {x[1]}"
            elif kind == "fma":
                text = f"call {T} @llvm.fma.{suffix}({T} {x[0]}, {T} {x[1]}, {T} {x[2]})"
            elif kind in _FUNCTIONS:
                text = f"call {T} @llvm.{_FUNCTIONS[kind]}.{suffix}({T} {x[0]})"
            elif kind in _COMPARISONS:
                text = f"fcmp {_COMPARISONS[kind]} {T} {x[0]}, {x[1]}"
            elif kind == "select":
                text = f"select {truth} {x[0]}, {T} {x[1]}, {T} {x[2]}"
            else:
                assert kind == "negate", kind
                text = f"fneg {T} {x[0]}"
            lines.append(f"  {name} = {text}")
        if place in wanted:
            store(place)
    return lines


def _size(shape: Sequence[int]) -> int:
    size = 1
    for n in shape:
        size *= n
    return size
