"""Write programs as functions in LLVM's language, and the calls of these functions that run a schedule.

A program becomes straight-line code on numbers or on vectors of lanes. No fast-math flag is set, so LLVM neither fuses
nor reorders operations: the results are those of the interpreter, bit for bit.
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from string import Template
from typing import NamedTuple

from holdfast.compiler.order import is_crowded
from holdfast.compiler.program import Program
from holdfast.compiler.schedule import Call
from holdfast.compiler.targets.layout import ArrayAddress, Layout
from holdfast.compiler.targets.split import (
    Access,
    NumberPlace,
    SplitPart,
    SplitProgram,
    signs_to_keep,
    split,
)

# A number in memory that has not been used for so many operations is loaded again. LLVM would keep it in a register, or
# rather write it to the stack, a second time, because more numbers are in use than there are registers. Where fewer are
# in use, there is less to gain, and compiling more loads takes longer.
_FAR, _FAR_IF_FEW_LIVE = 24, 64

# In programs of more than _FEW parts, what earlier parts have written is read through pointers of its own, to which
# nothing is written. LLVM need not order such loads and stores then, for which it takes time that grows with the square
# of their number: a third of its time for arms of 96 joints. In programs of few parts there is nothing to gain.
_BEFORE, _FEW = ".before", 4


Place = tuple[ArrayAddress | None, str | None]  # of an argument, and its offset if that is a variable


class ProgramInLlvm(NamedTuple):
    """A program in LLVM's language.

    Attributes:
        lines: the source of one or more LLVM functions.
        parameters: the names of the functions, in the order in which they are called, and the pointers that each takes.
            They are those of `split`; one to which an earlier part has written ends with `.before`.
        split: the program, split into one part for each function.
    """

    lines: list[str]
    parameters: dict[str, list[str]]
    split: SplitProgram


def function(
    name: str, program: Program, lanes: int, inputs: Sequence[Access], outputs: Sequence[Access], turns: bool
) -> ProgramInLlvm:
    """Return a program as one function, or several if it is long; for the arguments see `split`."""
    found = split(program, lanes, inputs, outputs, turns)
    lines: list[str] = []
    parameters: dict[str, list[str]] = {}
    known = [*found.parameters, *(pointer + _BEFORE for pointer in found.parameters)]
    for k, part in enumerate(found.parts):
        body, used = _body(part, lanes, _BEFORE if len(found.parts) > _FEW else "")
        own = parameters[f"{name}.{k}"] = [pointer for pointer in known if pointer in used]
        taken = ", ".join([f"ptr noalias %{pointer}" for pointer in own])
        lines += [f"define internal void @{name}.{k}({taken}) noinline nounwind {{", *body, "  ret void", "}"]
    return ProgramInLlvm(lines, parameters, found)


def declarations(lanes: int) -> list[str]:
    """Return the declarations of the intrinsics that functions on so many lanes call."""
    T = number_type(lanes)
    functions = [f"declare {T} @llvm.{name}.{_suffix(lanes)}({T})" for name in ("fabs", "sqrt")]
    functions += ["declare double @llvm.arithmetic.fence.f64(double)"] if lanes == 1 else []
    return [*functions, f"declare {T} @llvm.fma.{_suffix(lanes)}({T}, {T}, {T})"]


def number_type(lanes: int) -> str:
    """Return LLVM's type of one value."""
    return "double" if lanes == 1 else f"<{lanes} x double>"


def constant(value: float, lanes: int) -> str:
    """Return an LLVM constant with the number's bits in every lane."""
    bits = f"0x{struct.unpack('<Q', struct.pack('<d', value))[0]:016X}"
    return bits if lanes == 1 else f"splat (double {bits})"


def splat(name: str, scalar: str, lanes: int) -> list[str]:
    """Return the lines that define `name` as a vector with the same number in every lane."""
    T = number_type(lanes)
    return [
        f"  {name}.one = insertelement {T} poison, double {scalar}, i64 0",
        f"  {name} = shufflevector {T} {name}.one, {T} poison, <{lanes} x i32> zeroinitializer",
    ]


def _suffix(lanes: int) -> str:
    return "f64" if lanes == 1 else f"v{lanes}f64"


@functools.cache
def _operations(lanes: int) -> dict[str, str]:
    """Return the text of every operation on numbers or vectors, with %s for its operands."""
    T, suffix = number_type(lanes), _suffix(lanes)
    return {
        "add": f"fadd {T} %s, %s",
        "subtract": f"fsub {T} %s, %s",
        "multiply": f"fmul {T} %s, %s",
        "divide": f"fdiv {T} %s, %s",
        "negate": f"fneg {T} %s",
        "absolute": f"call {T} @llvm.fabs.{suffix}({T} %s)",
        "sqrt": f"call {T} @llvm.sqrt.{suffix}({T} %s)",
        "fma": f"call {T} @llvm.fma.{suffix}({T} %s, {T} %s, {T} %s)",
        "less": f"fcmp olt {T} %s, %s",
        "less_equal": f"fcmp ole {T} %s, %s",
        "select": f"select {'i1' if lanes == 1 else f'<{lanes} x i1>'} %s, {T} %s, {T} %s",
    }


def _body(part: SplitPart, lanes: int, before: str) -> tuple[list[str], set[str]]:
    """Return the lines of the operations and the pointers that they use.

    Numbers are loaded when they are used, and stored when they are computed. The names of pointers through which
    numbers of earlier parts are read end with `before`.
    """
    program, sources, wanted = part.program, part.sources, part.wanted
    T, operations = number_type(lanes), _operations(lanes)
    # Vectors have no instruction that would be wrong.
    kept = signs_to_keep(program, of_operands=False) if lanes == 1 else set[int]()
    lines: list[str] = []
    names: dict[int, str] = {}
    now = first_operation = program.input_size
    stored: dict[int, NumberPlace] = {}  # results and values for later parts that this part has computed
    addresses: dict[int, str] = {}  # of numbers in memory, by place
    used: dict[int, int] = {}  # when each of them was last used
    pointers: set[str] = set()
    far = _FAR if is_crowded(program) else _FAR_IF_FEW_LIVE

    def read(place: int) -> str:
        if place in names and now - used.get(place, now) <= far:
            if place in used:
                used[place] = now
            return names[place]
        kind, _, value = program.instructions[place]
        if kind == "constant":
            names[place] = constant(value, lanes)
            return names[place]
        own = f"{place}.{now}" if place in names else f"{place}"
        pointer, number, access = sources[place] if kind == "input" else stored[place]
        if place not in addresses:
            pointer += before if kind == "input" and not pointer.startswith("in") else ""
            pointers.add(pointer)
            addresses[place] = f"%i{place}"
            lines.append(f"  %i{place} = getelementptr double, ptr %{pointer}, i64 {number * access.step}")
        if access.splat and lanes > 1:
            lines.append(f"  %s{own} = load double, ptr {addresses[place]}, align 8")
            lines.extend(splat(f"%v{own}", f"%s{own}", lanes))
        else:
            lines.append(f"  %v{own} = load {T}, ptr {addresses[place]}, align {8 * lanes}")
        names[place], used[place] = f"%v{own}", now
        return names[place]

    def store(place: int) -> None:
        for target, at in wanted[place].items():
            (pointer, number, access), result = target, read(place)
            pointers.add(pointer)
            lines.append(f"  %{at} = getelementptr double, ptr %{pointer}, i64 {number * access.step}")
            lines.append(f"  store {T} {result}, ptr %{at}, align {8 * lanes}")
            used[place] = now
            if place >= first_operation:
                stored[place], addresses[place] = target, f"%{at}"

    for place in sorted(p for p in wanted if p < first_operation):
        store(place)
    for place in range(first_operation, len(program.instructions)):
        kind, args, _ = program.instructions[place]
        now = place
        if kind != "constant":
            x = tuple([read(a) for a in args])
            name = names[place] = f"%v{place}"
            if place in kept:
                lines.append(f"  {name}.kept = call double @llvm.arithmetic.fence.f64(double {x[0]})")
                x = (f"{name}.kept",)
            lines.append(f"  {name} = {operations[kind] % x}")
        if place in wanted:
            store(place)
    return lines, pointers


def filled(name: str, **values: object) -> str:
    """Return the template `name.ll` of this folder with every `$name` replaced; a list is a value of several lines."""
    texts = {key: "\n".join(value) if isinstance(value, list) else value for key, value in values.items()}
    return Template(Path(__file__).with_name(f"{name}.ll").read_text()).substitute(texts)


# So many groups of a batch run each function before the next function runs. Its instructions, which fill the caches of
# the processor, are fetched once for all of them, and one group is computed while operations of another wait; see
# LONGEST_OF_GROUPS. The working memory of two groups of eight lanes is too much for the nearest cache.
_TOGETHER, _MOST_LANES = 2, 4

_UNROLLED = 2  # up to so many calls are written one after the other; more become a loop


class Module:
    """Collects the source of a module.

    Attributes:
        layout: the addresses of all arrays.
        functions: the lines of the stage functions written so far.
        tables: constant tables of the addresses over which loops run.
        scratch: the number of doubles of scratch memory that the functions need.
        lanes: the vector lengths that the functions use.
        together: how many groups of systems, one in each lane, take turns.
    """

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self.together = _TOGETHER if 1 < layout.systems <= _MOST_LANES else 1
        self.functions: list[str] = []
        self.tables: list[str] = []
        self.scratch = 0
        self.lanes: set[int] = set()
        self._known: dict[object, ProgramInLlvm] = {}
        self._known_tables: dict[tuple[int, ...], str] = {}
        self._runners: dict[object, str] = {}
        self._labels = 0

    def calls(self, calls: Sequence[Call], lines: list[str], label: str, memories: Sequence[str] = ("%arena",)) -> str:
        """Append the lines that run the calls; return the label of the block they end in.

        Args:
            calls: the calls.
            lines: the lines of the function that is being written.
            label: the label of the block before.
            memories: the working memory of every lane group of a batch that runs each function before the next one.
        """
        for call in calls:
            made = self.written(call)
            runs = self.layout.places(call, made.split) if made.split.writes else []
            if len(runs) > _UNROLLED:
                label = self._loop(made, runs, lines, label, memories)
                continue
            items = [[(place, None) for place in places] for places in runs]
            free = self.together > 1 and self.layout.schedule.groups[call.group].side_by_side
            for some in [items] if free else [[item] for item in items]:
                self._run(made, some, lines, memories)
        return label

    def label(self) -> int:
        """Return a number that no label or variable uses yet."""
        self._labels += 1
        return self._labels

    def _loop(
        self,
        made: ProgramInLlvm,
        runs: list[list[ArrayAddress | None]],
        lines: list[str],
        label: str,
        memories: Sequence[str],
    ) -> str:
        n, count = self.label(), len(runs)
        lines += [f"  br label %loop{n}", f"loop{n}:"]
        lines.append(f"  %t{n} = phi i64 [ 0, %{label} ], [ %t{n}.next, %loop{n} ]")
        moved: list[tuple[ArrayAddress | None, str | None]] = []
        for place, *others in zip(*runs, strict=True):
            offsets = tuple([0 if at is None else at.offset for at in (place, *others)])
            moving = None
            if len(set(offsets)) > 1:
                table, j = self._table(offsets), len(moved)
                lines.append(f"  %a{n}.{j} = getelementptr i64, ptr {table}, i64 %t{n}")
                lines.append(f"  %o{n}.{j} = load i64, ptr %a{n}.{j}")
                moving = f"%o{n}.{j}"
            moved.append((place, moving))
        self._run(made, [moved], lines, memories)
        lines += [
            f"  %t{n}.next = add i64 %t{n}, 1",
            f"  %more{n} = icmp slt i64 %t{n}.next, {count}",
            f"  br i1 %more{n}, label %loop{n}, label %after{n}",
            f"after{n}:",
        ]
        return f"after{n}"

    def _table(self, offsets: tuple[int, ...]) -> str:
        if offsets not in self._known_tables:
            self._known_tables[offsets] = name = f"@table{len(self._known_tables)}"
            values = ", ".join([f"i64 {offset}" for offset in offsets])
            self.tables.append(f"{name} = private unnamed_addr constant [{len(offsets)} x i64] [{values}]")
        return self._known_tables[offsets]

    def _run(
        self, made: ProgramInLlvm, runs: Sequence[Sequence[Place]], lines: list[str], memories: Sequence[str]
    ) -> None:
        """Append the calls of a program's functions, each of them for all items and lane groups of a batch."""
        if self.layout.systems == 1:
            for places in runs:
                lines += self._called(made, made.parameters, _by_parameter(made, places), "%arena")
            return
        own = made.split.scratch * self.layout.systems  # scratch memory of an item
        self.scratch = max(self.scratch, own * len(runs))
        for name, parameters in made.parameters.items():
            used = dict.fromkeys([p.removesuffix(_BEFORE) for p in parameters])
            for r, places in enumerate(runs):
                given = _by_parameter(made, places)
                if made.split.scratch:
                    given["scratch"] = ArrayAddress(None, self.layout.total + r * own), None
                runner = self._runner(made, name, {p: given[p] for p in used})
                offsets = "".join([f", i64 {given[p][1]}" for p in used if given[p][1]])
                lines += [f"  call void @{runner}(ptr {memory}{offsets})" for memory in memories]

    def _runner(self, made: ProgramInLlvm, name: str, places: Mapping[str, Place]) -> str:
        """Return the name of the function that calls one of a program's functions for a lane group."""
        key = (name, tuple([place if moving is None else None for place, moving in places.values()]))
        if key not in self._runners:
            self._runners[key] = runner = f"run.{len(self._runners)}"
            taken = ["ptr %memory", *(f"i64 %{p}.offset" for p, (_, moving) in places.items() if moving)]
            own = {p: (place, moving and f"%{p}.offset") for p, (place, moving) in places.items()}
            head = f"define internal void @{runner}({', '.join(taken)}) noinline nounwind {{"
            self.functions += [head, *self._called(made, [name], own, "%memory"), "  ret void", "}"]
        return self._runners[key]

    def _called(self, made: ProgramInLlvm, names: Iterable[str], places: Mapping[str, Place], memory: str) -> list[str]:
        """Return the lines that compute addresses and call functions of a program with them."""
        n, lines, arguments = self.label(), list[str](), dict[str, str]()
        for pointer, (place, moving) in places.items():
            external = None if place is None else place.external
            base = memory if external is None else f"%external{external}"
            offset = moving or (self.layout.total if place is None else place.offset)
            lines.append(f"  %p{n}.{pointer} = getelementptr double, ptr {base}, i64 {offset}")
            arguments[pointer] = f"ptr %p{n}.{pointer}"
        for name in names:
            own = ", ".join([arguments[p.removesuffix(_BEFORE)] for p in made.parameters[name]])
            lines.append(f"  call void @{name}({own})")
        return lines

    def written(self, call: Call) -> ProgramInLlvm:
        """Return the function of a stage's phase for this layout; it is written at the first call only."""
        layout, stage = self.layout, self.layout.schedule.groups[call.group].stage
        inputs, outputs = layout.accesses(call)
        lanes = max(layout.systems, layout.width[call.group])
        program = layout.computed(call)
        handed = tuple([len(output.places) for output in program.outputs])
        key = (id(stage), call.phase, lanes, tuple(inputs), tuple(outputs), handed)
        if key not in self._known:
            name = f"{stage.name}.{call.phase}.{len(self._known)}"
            made = function(name, program, lanes, inputs, outputs, turns=self.together > 1)
            self.functions += made.lines
            self.scratch = max(self.scratch, made.split.scratch * lanes)
            self.lanes.add(lanes)
            self._known[key] = made
        return self._known[key]


def _by_parameter(made: ProgramInLlvm, places: Sequence[Place]) -> dict[str, Place]:
    return dict(zip(made.split.parameters, places, strict=True))
