"""The C source that runs a schedule for one system, as `llvm.single` does.

    int64_t name(const arrays_type *arrays)    void name_prepare(const arrays_type *arrays)

The structure `arrays` holds the addresses of the external arrays and of the working memory, `workspace`.

Programs become straight-line code of operations on doubles. `fma` is called where the program has it. With
`-ffp-contract=off` a C compiler adds no further fma and does not reorder operations, so the results are those of the
interpreter, bit for bit.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from holdfast.compiler.arithmetic import TRUTHS
from holdfast.compiler.program import Program
from holdfast.compiler.schedule import FIRST_BAD, NOT_FINITE, Call, Schedule
from holdfast.compiler.targets.layout import ArrayAddress, Layout
from holdfast.compiler.targets.split import Access, NumberPlace, SplitPart, SplitProgram, signs_to_keep, split

_WRITTEN_OUT = 2  # up to so many calls are written one after the other; more become a loop


def single_source(
    schedule: Schedule, names: tuple[str, str], arrays: str, fields: Mapping[str, str]
) -> tuple[str, int]:
    """Return the source and the number of doubles of working memory that it needs.

    Args:
        schedule: the schedule to run.
        names: the names of its two functions.
        arrays: the name of the C structure that holds the addresses.
        fields: the field of that structure for each array of the schedule, by the array's name.
    """
    writer = _Writer(schedule, names[0], list(fields.values()))
    single = [line for call in schedule.calls for line in writer.call(call)]
    prepare = [line for call in schedule.prepare for line in writer.call(call)]
    end = ["    return 0;"] if schedule.status is None else _status(schedule, schedule.status, fields)
    scratch = f"    double *const scratch = arrays->workspace + {writer.layout.total};"

    def body(lines: list[str]) -> list[str]:
        uses = any("scratch" in line for line in lines)
        return [*([scratch] if uses else []), *lines] if lines else ["    (void)arrays;"]

    public = ["", f"int64_t {names[0]}(const {arrays} *arrays)", "{", *body([*single, *end]), "}"]
    public += ["", f"void {names[1]}(const {arrays} *arrays)", "{", *body(prepare), "}"]
    return "\n".join([*writer.functions, *public, ""]), writer.layout.total + writer.scratch


class _Writer:
    """Collects the source of a schedule.

    Attributes:
        layout: the addresses of all arrays.
        functions: the lines of the stage functions written so far.
        scratch: the number of doubles of scratch memory that the functions need.
    """

    def __init__(self, schedule: Schedule, prefix: str, fields: list[str]) -> None:
        self.layout = Layout(schedule, 1)
        self.functions: list[str] = []
        self.scratch = 0
        self._prefix, self._fields = prefix, fields
        self._known: dict[object, ProgramInC] = {}
        self._tables = 0

    def call(self, call: Call) -> list[str]:
        """Return the lines that run one phase of a stage for its items."""
        made = self._function(call)
        runs = self.layout.places(call, made.split)
        if len(runs) <= _WRITTEN_OUT:
            every = [", ".join(map(self._pointer, places)) for places in runs]
            return [f"    {name}({arguments});" for arguments in every for name in made.names]
        table = f"at{self._tables}"
        self._tables += 1
        columns = [[0 if place is None else place.offset for place in column] for column in zip(*runs, strict=True)]
        moving = [k for k, column in enumerate(columns) if len(set(column)) > 1]
        shifts = {k: f"{table}[i][{j}]" for j, k in enumerate(moving)}
        arguments = ", ".join(self._pointer(place, shifts.get(k)) for k, place in enumerate(runs[0]))
        rows = [", ".join(str(columns[k][i]) for k in moving) for i in range(len(runs))]
        lines = [f"    static const int {table}[{len(runs)}][{len(moving)}] = {{"] if moving else []
        lines += [f"        {{{row}}}," for row in rows] if moving else []
        lines += ["    };"] if moving else []
        calls = [f"        {name}({arguments});" for name in made.names]
        return [*lines, f"    for (int i = 0; i < {len(runs)}; i++) {{", *calls, "    }"]

    def _pointer(self, place: ArrayAddress | None, shift: str | None = None) -> str:
        if place is None:
            return "scratch"
        array = "workspace" if place.external is None else self._fields[place.external]
        return f"arrays->{array} + {shift or place.offset}"

    def _function(self, call: Call) -> ProgramInC:
        """Return the function of a stage's phase; it is written at the first call only."""
        stage = self.layout.schedule.groups[call.group].stage
        inputs, outputs = self.layout.accesses(call)
        key = (id(stage), call.phase, tuple(inputs), tuple(outputs))
        if key not in self._known:
            own = re.sub(r"\W", "_", stage.name)
            name = f"{self._prefix}_{own}_{call.phase}_{len(self._known)}"
            made = function(name, stage.pieces.programs[call.phase], inputs, outputs)
            self.functions += made.lines
            self.scratch = max(self.scratch, made.split.scratch)
            self._known[key] = made
        return self._known[key]


def _status(schedule: Schedule, status: str, fields: Mapping[str, str]) -> list[str]:
    """Return the last lines, which set the status, replace results of bad status by NaN and return the status."""
    at = f"arrays->{fields[status]}[0]"
    sizes = [(fields[name], schedule.externals[name].size) for name in schedule.guarded]
    lines = ["    double odd = 0.0; /* x - x is 0 for every finite x */"]
    lines += [f"    for (int e = 0; e < {n}; e++) odd += arrays->{name}[e] - arrays->{name}[e];" for name, n in sizes]
    lines += [f"    if (odd != 0.0) {at} = {NOT_FINITE};", f"    if ({at} >= {FIRST_BAD}) {{"]
    lines += [f"        for (int e = 0; e < {size}; e++) arrays->{name}[e] = NAN;" for name, size in sizes]
    return [*lines, "    }", f"    return (int64_t){at};"]


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


class ProgramInC(NamedTuple):
    """A program in C.

    Attributes:
        lines: the source of one or more functions.
        names: the names of the functions, which are called in this order with the same arguments.
        split: the program, split into one part for each function.
    """

    lines: list[str]
    names: list[str]
    split: SplitProgram


def function(name: str, program: Program, inputs: Sequence[Access], outputs: Sequence[Access]) -> ProgramInC:
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
    return ProgramInC(lines, names, found)


def constant(value: float) -> str:
    """Return a number as an exact C constant."""
    if math.isnan(value):
        return "NAN"
    if math.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    short = repr(value)
    return short if len(short) < 8 else value.hex()


def _used(part: SplitPart) -> set[str]:
    """Return the pointers that a part reads or writes."""
    program = part.program
    read = {a for i in program.instructions for a in i.args} | {p for o in program.outputs for p in o.places}
    sources = {part.sources[a].pointer for a in read if 0 <= a < program.input_size}
    return sources | {number.pointer for numbers in part.wanted.values() for number in numbers}


def _body(part: SplitPart) -> list[str]:
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


def _at(number: NumberPlace) -> str:
    return f"{number.pointer}[{number.place * number.access.step}]"
