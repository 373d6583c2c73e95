"""Write a program as C functions: straight-line code of operations on doubles.

`fma` is called where the program has it. With `-ffp-contract=off` a C compiler adds no further fma and does not
reorder operations, so the results are those of the interpreter, bit for bit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from holdfast.compiler.arithmetic import TRUTHS
from holdfast.compiler.program import Program
from holdfast.compiler.targets.signs import signs_to_keep
from holdfast.compiler.targets.split import Access, Number, Part, SplitProgram, split

# What the functions need before them.
DEFINITIONS = """\
#define ONE_FUNCTION static __attribute__((noinline)) /* inlined, they would take compilers very long */

/* Compilers move signs into fma, where they are wrong if the sum is zero; not beyond this. */
static inline __attribute__((unused)) double kept(double x)
{
#if defined(__x86_64__) && !defined(__clang__)
    __asm__("" : "+x"(x));
#elif defined(__aarch64__)
    __asm__("" : "+w"(x));
#endif
    return x;
}
"""

_OPERATIONS: dict[str, Callable[..., str]] = {
    "add": lambda a, b: f"{a} + {b}",
    "subtract": lambda a, b: f"{a} - {b}",
    "multiply": lambda a, b: f"{a} * {b}",
    "divide": lambda a, b: f"{a} / {b}",
    "negate": lambda a: f"-({a})",
    "absolute": lambda a: f"fabs({a})",
    "sqrt": lambda a: f"sqrt({a})",
    "fma": lambda a, b, c: f"fma({a}, {b}, {c})",
    "less": lambda a, b: f"{a} < {b}",
    "less_equal": lambda a, b: f"{a} <= {b}",
    "select": lambda condition, a, b: f"{condition} ? {a} : {b}",
}


class Function(NamedTuple):
    """A program in C.

    Attributes:
        lines: the source of one or more functions.
        names: the names of the functions, which are called in this order with the same arguments.
        split: the program, split into one part for each function.
    """

    lines: list[str]
    names: list[str]
    split: SplitProgram


def function(name: str, program: Program, inputs: Sequence[Access], outputs: Sequence[Access]) -> Function:
    """Return a program as one function, or several if it is long."""
    found = split(program, 1, inputs, outputs)
    pointers = [f"{'const ' if p.startswith('in') else ''}double *restrict {p}" for p in found.parameters]
    names = [name if len(found.parts) == 1 else f"{name}_{k}" for k in range(len(found.parts))]
    lines: list[str] = []
    for own, part in zip(names, found.parts, strict=True):
        lines += ["", f"ONE_FUNCTION void {own}({', '.join(pointers)})", "{"]
        # All parts have the same parameters, but a part need not use all of them.
        unused = [p for p in found.parameters if p not in _used(part)]
        lines += [f"    (void){pointer};" for pointer in unused]
        lines += [*(f"    {line}" for line in _body(part)), "}"]
    return Function(lines, names, found)


def constant(value: float) -> str:
    """Return a number as an exact C constant."""
    if math.isnan(value):
        return "NAN"
    if math.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    short = repr(value)
    return short if len(short) < 8 else value.hex()


def _used(part: Part) -> set[str]:
    """Return the pointers that a part reads or writes."""
    program = part.program
    read = {a for i in program.instructions for a in i.args} | {p for o in program.outputs for p in o.places}
    sources = {part.sources[a].pointer for a in read if 0 <= a < program.input_size}
    return sources | {number.pointer for numbers in part.wanted.values() for number in numbers}


def _body(part: Part) -> list[str]:
    """Return the lines of the operations; every result is stored as soon as it is computed."""
    program, wanted, kept = part.program, part.wanted, signs_to_keep(part.program, of_operands=True)
    names: dict[int, str] = {}
    lines: list[str] = []

    def read(place: int) -> str:
        if place not in names:
            kind, _, value = program.instructions[place]
            names[place] = constant(value) if kind == "constant" else _at(part.sources[place])
        return names[place]

    def store(place: int) -> None:
        lines.extend(f"{_at(number)} = {read(place)};" for number in wanted[place])

    for place in sorted(p for p in wanted if p < program.input_size):
        store(place)
    for place in range(program.input_size, len(program.instructions)):
        kind, args, _ = program.instructions[place]
        if kind != "constant":
            operands = [read(a) for a in args]
            text = f"-kept({operands[0]})" if place in kept else _OPERATIONS[kind](*operands)
            names[place] = f"v{place}"
            lines.append(f"const {'int' if kind in TRUTHS else 'double'} v{place} = {text};")
        if place in wanted:
            store(place)
    return lines


def _at(number: Number) -> str:
    return f"{number.pointer}[{number.place * number.access.step}]"
