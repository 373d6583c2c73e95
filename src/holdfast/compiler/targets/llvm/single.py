"""The LLVM module that runs a schedule for one system.

    i64 single(i64 *table)    void prepare(i64 *table)

`table` holds the addresses of the external arrays in order, then that of the working memory. `prepare` computes what
depends on parameters only. `single` returns the status as an integer, which is 0 if there was no problem, and
leaves in carried arrays what the next repetition begins with.
"""

from __future__ import annotations

import math

from holdfast.compiler.schedule import FIRST_BAD, NOT_FINITE, Schedule
from holdfast.compiler.stage import Wire
from holdfast.compiler.targets.layout import Area, Layout
from holdfast.compiler.targets.llvm.functions import Module, constant, declarations, filled, number_type
from holdfast.compiler.targets.llvm.transposition import masked_load, of_items

_INLINE = 32  # up to so many numbers of an array are checked in straight-line code; more are checked in a loop


def single_module(schedule: Schedule, lanes: int, names: tuple[str, str] = ("single", "prepare")) -> tuple[str, int]:
    """Return the module's source and the number of doubles of working memory that it needs.

    Args:
        schedule: the schedule to run.
        lanes: how many items of a group are computed side by side.
        names: the names of its two functions.
    """
    layout = Layout(schedule, lanes)
    module = Module(layout)
    roles = {name: external.role for name, external in schedule.externals.items()}
    single, prepare = (_head(what, name, layout) for what, name in zip(("i64", "void"), names, strict=True))
    prepared = entered = "entry"
    moves: dict[tuple[str, int, int], list[str]] = {}
    for (group, port), area in layout.packed.items():
        stage, wire = schedule.groups[group].stage, schedule.groups[group].wires[port]
        if port in stage.input_ports and roles[wire.array] == "parameter":
            prepared = _move(prepare, module, wire, area, prepared, "to_lanes", moves)
        elif port in stage.input_ports:
            entered = _move(single, module, wire, area, entered, "to_lanes", moves)
    module.calls(schedule.prepare, prepare, prepared)
    prepare += ["  ret void", "}"]
    end = entered
    for call in schedule.calls:
        end = module.calls([call], single, end)
        for port in schedule.groups[call.group].stage.outputs[call.phase]:
            area = layout.packed.get((call.group, port))
            if area is not None:
                wire = schedule.groups[call.group].wires[port]
                end = _move(single, module, wire, area, end, "from_lanes", moves)
    declared = [line for n in sorted(module.lanes | {1, lanes}) for line in declarations(n)]
    if schedule.status is None:
        single += ["  ret i64 0", "}"]
    else:
        single += _status(schedule, schedule.status, lanes)
        declared += _guard(lanes)
    declared += [masked_load(n) for n in sorted({lanes for _, _, lanes in moves})]
    declared += [line for lines in moves.values() for line in lines]
    text = [*declared, *module.tables, *module.functions, *prepare, *single]
    return "\n".join(text), layout.total + module.scratch


def _head(result: str, name: str, layout: Layout) -> list[str]:
    lines = [f"define {result} @{name}(ptr %table) nounwind {{", "entry:"]
    count = len(layout.schedule.externals)
    for k in range(count + 1):
        array = f"%external{k}" if k < count else "%arena"
        lines.append(f"  %address{k} = getelementptr ptr, ptr %table, i64 {k}")
        lines.append(f"  {array} = load ptr, ptr %address{k}")
    return lines


def _move(
    lines: list[str],
    module: Module,
    wire: Wire,
    area: Area,
    label: str,
    name: str,
    moves: dict[tuple[str, int, int], list[str]],
) -> str:
    """Write the code that copies items from an external array into lanes, or back; return the last block's label.

    Lanes without an item receive the numbers of the last item. On the way back they are written before it, so that
    the results of the last item overwrite theirs.

    Args:
        lines: the lines of the function that is being written.
        module: the module that it is part of.
        wire: where the items' numbers are in the external array.
        area: where they are in lanes.
        label: the label of the block before.
        name: `to_lanes` or `from_lanes`.
        moves: the functions that copy, as far as they have been written.
    """
    k, width = list(module.layout.schedule.externals).index(wire.array), area.width
    n, count = module.label(), -(-len(wire.places) // width)
    key = (name, area.size, width)
    if key not in moves:
        moves[key] = of_items(*key)
    lines += [f"  br label %move{n}", f"move{n}:", f"  %b{n} = phi i64 [ 0, %{label} ], [ %b{n}.next, %move{n} ]"]
    rows = []
    for j in range(width):
        places = [wire.places[min(b * width + j, len(wire.places) - 1)] for b in range(count)]
        shift = f"{places[0]}"
        if count > 1:
            values = ", ".join(f"i64 {place}" for place in places)
            module.tables.append(f"@lane{n}.{j} = private unnamed_addr constant [{count} x i64] [{values}]")
            lines.append(f"  %l{n}.{j} = getelementptr i64, ptr @lane{n}.{j}, i64 %b{n}")
            lines.append(f"  %s{n}.{j} = load i64, ptr %l{n}.{j}")
            shift = f"%s{n}.{j}"
        lines.append(f"  %row{n}.{j} = getelementptr double, ptr %external{k}, i64 {shift}")
        rows.append(f"ptr %row{n}.{j}")
    lines += [
        f"  %shift{n} = mul i64 %b{n}, {area.size * width}",
        f"  %here{n} = add i64 %shift{n}, {area.start}",
        f"  %block{n} = getelementptr double, ptr %arena, i64 %here{n}",
        f"  call void @{name}.{area.size}.{width}(ptr %block{n}, {', '.join(rows)})",
        f"  %b{n}.next = add i64 %b{n}, 1",
        f"  %more{n} = icmp slt i64 %b{n}.next, {count}",
        f"  br i1 %more{n}, label %move{n}, label %moved{n}",
        f"moved{n}:",
    ]
    return f"moved{n}"


def _status(schedule: Schedule, status: str, lanes: int) -> list[str]:
    """Return the last lines of `single`, which set and return the status and replace results of bad status by NaN."""
    index = {name: k for k, name in enumerate(schedule.externals)}
    T, zero = number_type(lanes), constant(0.0, lanes)
    lines: list[str] = []
    wide, narrow, flags = zero, "0.0", ["false"]
    for name in schedule.guarded:
        k, size = index[name], schedule.externals[name].size
        if size > _INLINE:
            lines.append(f"  %flag{k} = call i1 @unsound(ptr %external{k}, i64 {size})")
            flags.append(f"%flag{k}")
            continue
        whole = size - size % lanes
        for e in range(0, whole, lanes):
            wide = _difference(lines, f"%w{k}.{e}", T, k, e, wide)
        for e in range(whole, size):
            narrow = _difference(lines, f"%n{k}.{e}", "double", k, e, narrow)
    lines.append(f"  %wide.bad = fcmp une {T} {wide}, {zero}")
    lines.append(f"  %flag.wide = {_any(lanes, '%wide.bad')}")
    lines.append(f"  %flag.narrow = fcmp une double {narrow}, 0.0")
    unsound = "%flag.narrow"
    for j, flag in enumerate(["%flag.wide", *flags]):
        lines.append(f"  %unsound{j} = or i1 {unsound}, {flag}")
        unsound = f"%unsound{j}"
    end = filled(
        "single_status",
        status=f"%external{index[status]}",
        unsound=unsound,
        not_finite=constant(NOT_FINITE, 1),
        first_bad=constant(FIRST_BAD, 1),
        blank=[
            f"  call void @blank(ptr %external{index[name]}, i64 {schedule.externals[name].size})"
            for name in schedule.guarded
        ],
    )
    return [*lines, end]


def _difference(lines: list[str], name: str, T: str, k: int, e: int, before: str) -> str:
    """Append the lines that add x - x, which is 0 for every finite x, to a sum; return the name of the sum."""
    lines.append(f"  {name}.a = getelementptr double, ptr %external{k}, i64 {e}")
    lines.append(f"  {name}.x = load {T}, ptr {name}.a, align 8")
    lines.append(f"  {name}.d = fsub {T} {name}.x, {name}.x")
    lines.append(f"  {name} = fadd {T} {before}, {name}.d")
    return name


def _any(lanes: int, truth: str) -> str:
    if lanes == 1:
        return f"or i1 {truth}, false"
    return f"call i1 @llvm.vector.reduce.or.v{lanes}i1(<{lanes} x i1> {truth})"


def _guard(lanes: int) -> list[str]:
    """Return the functions `unsound` (whether any of n numbers is not finite) and `blank` (sets n numbers to NaN)."""
    reduce = [f"declare i1 @llvm.vector.reduce.or.v{lanes}i1(<{lanes} x i1>)"] if lanes > 1 else []
    values = {"lanes": lanes, "T": number_type(lanes), "zero": constant(0.0, lanes), "nan": constant(math.nan, 1)}
    steps = {f"step{k}": k * lanes for k in range(5)}
    return [*reduce, filled("single_guard", **values, **steps, any_odd=_any(lanes, "%odd"))]
