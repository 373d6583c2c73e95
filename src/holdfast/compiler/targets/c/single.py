"""The C source that runs a schedule for one system, as `llvm.single` does.

    int64_t name(const arrays_type *arrays)    void name_prepare(const arrays_type *arrays)

The structure `arrays` holds the addresses of the external arrays and of the working memory, `workspace`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from holdfast.compiler.schedule import FIRST_BAD, NOT_FINITE, Call, Schedule
from holdfast.compiler.targets.c.functions import Function, function
from holdfast.compiler.targets.layout import Address, Layout

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
        self._known: dict[object, Function] = {}
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

    def _pointer(self, place: Address | None, shift: str | None = None) -> str:
        if place is None:
            return "scratch"
        array = "workspace" if place.external is None else self._fields[place.external]
        return f"arrays->{array} + {shift or place.offset}"

    def _function(self, call: Call) -> Function:
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
