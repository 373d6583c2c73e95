"""The LLVM module that runs a schedule for a batch, one system in each lane.

    void batch(i64 *table, i64 begin, i64 end, i64 count, i64 repeats, double *arena)

The function runs the groups begin <= b < end, each of `lanes` systems; if the schedule has carried arrays, each group
is run `repeats` times in a row. `table` holds the address and the stride of every external array in order; the stride
is the number of doubles from one system to the next, or 0 if all systems share the array. Lanes beyond the last
system repeat it: they compute and write the same bits again, so a tail needs no code of its own.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from holdfast.compiler.schedule import FIRST_BAD, NOT_FINITE, ExternalRole, Schedule
from holdfast.compiler.targets.layout import Layout
from holdfast.compiler.targets.llvm.functions import Module, constant, declarations, filled, number_type
from holdfast.compiler.targets.llvm.transposition import transpositions

_ROW = 64  # results of so many numbers go past the caches,
_LARGE = 2**17  # if they are so many doubles in all: memory then need not be read before it is written

_WAYS: dict[ExternalRole, tuple[str, ...]] = {
    "input": ("to_lanes",),
    "parameter": ("to_lanes",),
    "output": ("from_lanes",),
    "carried": ("to_lanes", "from_lanes"),
}


def batch_module(schedule: Schedule, lanes: int) -> tuple[str, int]:
    """Return the module's source and the number of doubles of working memory that a thread needs."""
    layout = Layout(schedule, lanes, systems=lanes)
    module, copies = Module(layout), _Copies(layout)
    strides, varied = [], "0"
    for k, external in enumerate(schedule.externals.values()):
        if external.role == "parameter":
            row = f"  %row{k} = getelementptr i64, ptr %table, i64 {2 * k + 1}"
            strides += [row, f"  %own{k} = load i64, ptr %row{k}"]
            strides.append(f"  %varied{k} = or i64 {varied}, %own{k}")
            varied = f"%varied{k}"
    guarded = [name for name in schedule.guarded if schedule.externals[name].size]
    last = {} if schedule.names("carried") else _last_calls(schedule)
    long = [name for name in guarded if schedule.externals[name].size >= _ROW and name in last]
    zero = f"  store {number_type(lanes)} {constant(0.0, lanes)}, ptr %sums, align {8 * lanes}"
    copies.write("take.parameters", copies.moved("to_lanes", "parameter"))
    copies.write("take", [zero, *copies.moved("to_lanes", "input"), *copies.moved("to_lanes", "carried")])
    given = sorted({last[name] for name in long})
    for k in given:
        copies.write(f"give.{k}", copies.summed([name for name in long if last[name] == k]))
    rest = copies.summed([name for name in guarded if name not in long])
    rest += [copies.status(schedule.status, guarded)] if schedule.status is not None else []
    rest += [*copies.moved("from_lanes", "output", but=guarded), *copies.moved("from_lanes", "carried")]
    copies.write("give", rest)

    def prepare(groups: int) -> list[str]:
        """Return the lines that compute what depends on parameters only."""
        lines = copies.called("take.parameters", groups)
        module.calls(schedule.prepare, lines, "entry", _memories(groups))
        return lines

    def compute(groups: int) -> list[str]:
        """Return the lines that compute the rest, from the caller's arrays to the caller's arrays."""
        lines, label = copies.called("take", groups), "entry"
        if schedule.names("carried"):
            repeated: list[str] = []
            module.calls(schedule.calls, repeated, "repeat", _memories(groups))
            lines.append(filled("batch_repeated", calls=repeated))
        else:
            for k, call in enumerate(schedule.calls):
                label = module.calls([call], lines, label, _memories(groups))
                if k in given:  # while the caches hold the results
                    lines += copies.called(f"give.{k}", groups)
        return [*lines, *copies.called("give", groups)]

    bodies = {(of.__name__, n): of(n) for of in (prepare, compute) for n in sorted({1, module.together})}
    size = -(-(layout.total + module.scratch) // 8) * 8  # whole cache lines
    functions = [line for (of, n), body in bodies.items() for line in _of_groups(f"{of}.{n}", n, body, size, lanes)]
    moves = [(way, e.size) for e in schedule.externals.values() for way in _WAYS[e.role] if e.size]
    sizes = [schedule.externals[name].size for name in guarded]
    moves += [("checked", size) for size in sizes] + [("streamed", size) for size in sizes if size >= _ROW]
    declared = [*declarations(lanes), *transpositions(moves, lanes)]
    if schedule.status is not None:
        nan = constant(math.nan, lanes)
        values = {"lanes": lanes, "T": number_type(lanes), "align": 8 * lanes, "nan": nan, "zero": constant(0.0, lanes)}
        declared.append(filled("batch_guard", **values))
    text = [*declared, *module.tables, *module.functions, *copies.functions, *functions]
    text.append(filled("batch", lanes=lanes, together=module.together, strides=strides, varied=varied))
    return "\n".join(text), module.together * size


def _memories(groups: int) -> list[str]:
    return [f"%memory{g}" for g in range(groups)]


def _of_groups(name: str, groups: int, body: list[str], size: int, lanes: int) -> list[str]:
    """Return a function that runs so many groups, from system `first` on."""
    taken = "ptr %table, i64 %first, i64 %count, i64 %repeats, ptr %arena"
    lines = [f"define internal void @{name}({taken}) noinline nounwind {{", "entry:"]
    for g, memory in enumerate(_memories(groups)):
        lines.append(f"  {memory} = getelementptr double, ptr %arena, i64 {g * size}")
        lines.append(f"  %first{g} = add i64 %first, {g * lanes}")
    return [*lines, *body, "  ret void", "}"]


class _Copies:
    """Writes the functions that copy arrays of a lane group between the caller's memory and lanes.

    Attributes:
        functions: the lines of the functions written so far.
    """

    def __init__(self, layout: Layout) -> None:
        self.functions: list[str] = []
        self._layout, self._externals, self._lanes = layout, layout.schedule.externals, layout.systems

    def write(self, name: str, body: list[str]) -> None:
        """Write a function, with the addresses of all arrays that its body names."""
        text = "\n".join(body)
        head = [f"  %sums = getelementptr double, ptr %arena, i64 {self._layout.sums}"]
        for k, (array, external) in enumerate(self._externals.items()):
            if not re.search(rf"%(external|lanes){k}\b", text):
                continue
            head += [
                f"  %address{k} = getelementptr ptr, ptr %table, i64 {2 * k}",
                f"  %external{k} = load ptr, ptr %address{k}",
                f"  %at{k} = getelementptr i64, ptr %table, i64 {2 * k + 1}",
                f"  %stride{k} = load i64, ptr %at{k}",
                f"  %lanes{k} = getelementptr double, ptr %arena, i64 {self._layout.external_areas[array].start}",
            ]
            if f"%copy{k}(" in text:
                values = {"k": k, "size": external.size, "lanes": self._lanes, "mask": self._lanes - 1, "large": _LARGE}
                head.append(filled("batch_streamed", **values))
        self.functions += [
            f"define internal void @{name}(ptr %table, i64 %first, i64 %count, ptr %arena) noinline nounwind {{",
            "entry:",
            "  %last = sub i64 %count, 1",
            *head,
            text,
            "  ret void",
            "}",
        ]

    def called(self, name: str, groups: int) -> list[str]:
        """Return the calls of a function for so many groups."""
        return [
            f"  call void @{name}(ptr %table, i64 %first{g}, i64 %count, ptr {memory})"
            for g, memory in enumerate(_memories(groups))
        ]

    def moved(self, function: str, role: ExternalRole, but: Sequence[str] = ()) -> list[str]:
        """Return the lines that copy the arrays of a role."""
        return [
            f"  call void @{function}.{external.size}{_arguments(k)}"
            for k, (name, external) in enumerate(self._externals.items())
            if external.role == role and external.size and name not in but
        ]

    def summed(self, names: Sequence[str]) -> list[str]:
        """Return the lines that copy results from lanes, and add up x - x on the way."""
        if not names:
            return []
        T, align = number_type(self._lanes), 8 * self._lanes
        lines, total = [f"  %before = load {T}, ptr %sums, align {align}"], "%before"
        for k, (name, external) in enumerate(self._externals.items()):
            if name in names:
                function = f"%copy{k}" if external.size >= _ROW else f"@checked.{external.size}"
                lines.append(f"  %sum{k} = call {T} {function}{_arguments(k)}")
                lines.append(f"  %total{k} = fadd {T} {total}, %sum{k}")
                total = f"%total{k}"
        return [*lines, f"  store {T} {total}, ptr %sums, align {align}"]

    def status(self, status: str, guarded: Sequence[str]) -> str:
        """Return the code that sets the status of systems with non-finite results and blanks results of bad status."""
        lanes, index = self._lanes, {name: k for k, name in enumerate(self._externals)}
        blank: list[str] = []
        for name in guarded:
            k, size = index[name], self._externals[name].size
            blank.append(f"  call void @blank(ptr %lanes{k}, i64 {size}, <{lanes} x i1> %bad)")
            blank.append(f"  call void @from_lanes.{size}{_arguments(k)}")
        return filled(
            "batch_status",
            lanes=lanes,
            T=number_type(lanes),
            align=8 * lanes,
            zero=constant(0.0, lanes),
            status=f"%lanes{index[status]}",
            not_finite=constant(NOT_FINITE, lanes),
            first_bad=constant(FIRST_BAD, lanes),
            blank=blank,
        )


def _arguments(k: int) -> str:
    return f"(ptr %external{k}, i64 %stride{k}, i64 %first, i64 %last, ptr %lanes{k})"


def _last_calls(schedule: Schedule) -> dict[str, int]:
    """Return which call writes to an array last, for arrays that are written to."""
    found: dict[str, int] = {}
    for k, call in enumerate(schedule.calls):
        group = schedule.groups[call.group]
        found |= {group.wires[port].array: k for port in group.stage.outputs[call.phase]}
    return found
