"""The parts that the modules of single calls and of batches share: stage functions and their calls."""

from __future__ import annotations

from collections.abc import Sequence

from holdfast.compiler.schedule import Call
from holdfast.compiler.targets.layout import Address, Layout
from holdfast.compiler.targets.llvm.functions import Function, function

_UNROLLED = 2  # up to so many calls are written one after the other; more become a loop


class Module:
    """Collects the source of a module.

    Attributes:
        layout: the addresses of all arrays.
        functions: the lines of the stage functions written so far.
        tables: constant tables of the addresses over which loops run.
        scratch: the number of doubles of scratch memory that the functions need.
        lanes: the vector lengths that the functions use.
    """

    def __init__(self, layout: Layout) -> None:
        self.layout = layout
        self.functions: list[str] = []
        self.tables: list[str] = []
        self.scratch = 0
        self.lanes: set[int] = set()
        self._known: dict[object, Function] = {}
        self._labels = 0

    def calls(self, calls: Sequence[Call], lines: list[str], label: str) -> str:
        """Append the lines that run the calls; return the label of the block they end in."""
        for call in calls:
            label = self._call(call, lines, label)
        return label

    def label(self) -> int:
        """Return a number that no label or variable uses yet."""
        self._labels += 1
        return self._labels

    def _call(self, call: Call, lines: list[str], label: str) -> str:
        made = self._function(call)
        if not made.split.writes:
            return label
        runs = self.layout.places(call, made.split)
        if len(runs) <= _UNROLLED:
            for places in runs:
                n = self.label()
                pointers = [_pointer(lines, f"%p{n}.{j}", place, None) for j, place in enumerate(places)]
                lines += made.calls(pointers)
            return label
        return self._loop(made, runs, lines, label)

    def _loop(self, made: Function, runs: list[list[Address | None]], lines: list[str], label: str) -> str:
        n, count = self.label(), len(runs)
        lines += [f"  br label %loop{n}", f"loop{n}:"]
        lines.append(f"  %t{n} = phi i64 [ 0, %{label} ], [ %t{n}.next, %loop{n} ]")
        pointers = []
        for j, place in enumerate(runs[0]):
            offsets = [run[j].offset for run in runs if run[j] is not None]  # type: ignore[union-attr]
            moving = None
            if len(set(offsets)) > 1:
                values = ", ".join(f"i64 {offset}" for offset in offsets)
                self.tables.append(f"@table{n}.{j} = private unnamed_addr constant [{count} x i64] [{values}]")
                lines.append(f"  %a{n}.{j} = getelementptr i64, ptr @table{n}.{j}, i64 %t{n}")
                lines.append(f"  %o{n}.{j} = load i64, ptr %a{n}.{j}")
                moving = f"%o{n}.{j}"
            pointers.append(_pointer(lines, f"%p{n}.{j}", place, moving))
        lines += made.calls(pointers)
        lines += [
            f"  %t{n}.next = add i64 %t{n}, 1",
            f"  %more{n} = icmp slt i64 %t{n}.next, {count}",
            f"  br i1 %more{n}, label %loop{n}, label %after{n}",
            f"after{n}:",
        ]
        return f"after{n}"

    def _function(self, call: Call) -> Function:
        """Return the function of a stage's phase for this layout; it is written at the first call only."""
        layout, stage = self.layout, self.layout.schedule.groups[call.group].stage
        inputs, outputs = layout.accesses(call)
        lanes = max(layout.systems, layout.width[call.group])
        program = layout.computed(call)
        handed = tuple([len(output.places) for output in program.outputs])
        key = (id(stage), call.phase, lanes, tuple(inputs), tuple(outputs), handed)
        if key not in self._known:
            name = f"{stage.name}.{call.phase}.{len(self._known)}"
            made = function(name, program, lanes, inputs, outputs)
            self.functions += made.lines
            self.scratch = max(self.scratch, made.split.scratch * lanes)
            self.lanes.add(lanes)
            self._known[key] = made
        return self._known[key]


def _pointer(lines: list[str], name: str, place: Address | None, moving: str | None) -> str:
    """Append the line that computes an address; return the argument."""
    if place is None:
        return "ptr %scratch"
    base = "%arena" if place.external is None else f"%external{place.external}"
    lines.append(f"  {name} = getelementptr double, ptr {base}, i64 {moving or place.offset}")
    return f"ptr {name}"
