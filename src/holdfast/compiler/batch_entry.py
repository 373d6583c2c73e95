"""The module that runs a schedule for a batch, one system in each lane.

    void batch(i64 *table, i64 begin, i64 end, i64 count, i64 repeats, double *arena)

runs blocks begin <= b < end of `lanes` systems, each so many times in a row if the schedule
carries arrays on. `table` holds address and stride (doubles from one system to the next, 0: shared
by all) of every external array, in order. Lanes beyond the last system repeat it: they compute, and
write, the same bits again, so a tail needs no code of its own.
"""

from __future__ import annotations

import math

from holdfast.compiler import schedule as schedules
from holdfast.compiler.layout import Layout
from holdfast.compiler.llvm import constant, declarations, number_type
from holdfast.compiler.module import Module
from holdfast.compiler.schedule import Schedule
from holdfast.compiler.transposition import transpositions

_WAYS: dict[schedules.Role, tuple[str, ...]] = {
    "input": ("to_lanes",),
    "parameter": ("to_lanes",),
    "output": ("from_lanes",),
    "carried": ("to_lanes", "from_lanes"),
}


def batch_module(schedule: Schedule, lanes: int) -> tuple[str, int]:
    """Return the module's text and how many doubles of working memory a thread needs."""
    layout = Layout(schedule, lanes, systems=lanes)
    module = Module(layout)
    names = list(schedule.externals)
    lines = [
        "define void @batch(ptr %table, i64 %begin, i64 %end, i64 %count, i64 %repeats, ptr %arena) nounwind {",
        "entry:",
        f"  %scratch = getelementptr double, ptr %arena, i64 {layout.total}",
        "  %last = sub i64 %count, 1",
    ]
    for k, name in enumerate(names):
        lines += [
            f"  %address{k} = getelementptr ptr, ptr %table, i64 {2 * k}",
            f"  %external{k} = load ptr, ptr %address{k}",
            f"  %at{k} = getelementptr i64, ptr %table, i64 {2 * k + 1}",
            f"  %stride{k} = load i64, ptr %at{k}",
            f"  %lanes{k} = getelementptr double, ptr %arena, i64 {layout.external_areas[name].start}",
        ]
    strides = "0"
    for k, name in enumerate(names):
        if schedule.externals[name].role == "parameter":
            lines.append(f"  %strides{k} = or i64 {strides}, %stride{k}")
            strides = f"%strides{k}"
    lines += [
        f"  %varied = icmp ne i64 {strides}, 0",
        "  %any = icmp slt i64 %begin, %end",
        "  br i1 %any, label %next, label %done",
        "next:",
        "  %b = phi i64 [ %begin, %entry ], [ %b.next, %stored ]",
        f"  %first = mul i64 %b, {lanes}",
        "  %start = icmp eq i64 %b, %begin",
        "  %needed = or i1 %start, %varied",
        "  br i1 %needed, label %prepare, label %compute",
        "prepare:",
        *_moved("to_lanes", schedule, "parameter"),
    ]
    module.calls(schedule.prepare, lines, "prepare")
    lines += ["  br label %compute", "compute:"]
    lines += [*_moved("to_lanes", schedule, "input"), *_moved("to_lanes", schedule, "carried")]
    if schedule.names("carried"):
        _repeated(module, lines)
    else:
        module.calls(schedule.calls, lines, "compute")
    lines += _guard(schedule, layout, lanes)
    lines += [
        *_moved("from_lanes", schedule, "output"),
        *_moved("from_lanes", schedule, "carried"),
        "  br label %stored",
        "stored:",
        "  %b.next = add i64 %b, 1",
        "  %more = icmp slt i64 %b.next, %end",
        "  br i1 %more, label %next, label %done",
        "done:",
        "  ret void",
        "}",
    ]
    moves = [(way, e.size) for e in schedule.externals.values() for way in _WAYS[e.role] if e.size]
    declared = [*declarations(lanes), *transpositions(moves, lanes)]
    if schedule.status is not None:
        declared += _watchers(lanes)
    return "\n".join([*declared, *module.tables, *module.functions, *lines]), layout.total + module.scratch


def _moved(function: str, schedule: Schedule, role: schedules.Role) -> list[str]:
    return [
        f"  call void @{function}.{external.size}(ptr %external{k}, i64 %stride{k}, i64 %first, i64 %last,"
        f" ptr %lanes{k})"
        for k, external in enumerate(schedule.externals.values())
        if external.role == role and external.size
    ]


def _repeated(module: Module, lines: list[str]) -> None:
    """Append the calls in a loop: the systems stay in lanes meanwhile."""
    lines += ["  br label %repeat", "repeat:", "  %r = phi i64 [ 0, %compute ], [ %r.next, %repeated ]"]
    module.calls(module.layout.schedule.calls, lines, "repeat")
    lines += [
        "  br label %repeated",
        "repeated:",
        "  %r.next = add i64 %r, 1",
        "  %again = icmp slt i64 %r.next, %repeats",
        "  br i1 %again, label %repeat, label %finished",
        "finished:",
    ]


def _guard(schedule: Schedule, layout: Layout, lanes: int) -> list[str]:
    """Return what sets the status of systems with results that are not finite, and takes back bad results."""
    if schedule.status is None:
        return []
    T = number_type(lanes)
    index = {name: k for k, name in enumerate(schedule.externals)}
    guarded = [(index[name], schedule.externals[name].size) for name in schedule.guarded]
    lines: list[str] = []
    total = constant(0.0, lanes)
    for k, size in guarded:
        lines.append(f"  %sum{k} = call {T} @differences(ptr %lanes{k}, i64 {size}, {T} {total})")
        total = f"%sum{k}"
    status = f"%lanes{index[schedule.status]}"
    return [
        *lines,
        f"  %unsound = fcmp une {T} {total}, {constant(0.0, lanes)}",
        f"  %told = load {T}, ptr {status}, align {8 * lanes}",
        f"  %status = select <{lanes} x i1> %unsound, {T} {constant(schedules.NOT_FINITE, lanes)}, {T} %told",
        f"  store {T} %status, ptr {status}, align {8 * lanes}",
        f"  %bad = fcmp oge {T} %status, {constant(schedules.FIRST_BAD, lanes)}",
        f"  %some = call i1 @llvm.vector.reduce.or.v{lanes}i1(<{lanes} x i1> %bad)",
        "  br i1 %some, label %take.back, label %store",
        "take.back:",
        *(f"  call void @blank(ptr %lanes{k}, i64 {size}, <{lanes} x i1> %bad)" for k, size in guarded),
        "  br label %store",
        "store:",
    ]


def _watchers(lanes: int) -> list[str]:
    """Return `differences`, which adds x - x (0 for every finite x), and `blank`, which takes results back."""
    T = number_type(lanes)
    at = [f"  %k = mul i64 %e, {lanes}", "  %at = getelementptr double, ptr %x, i64 %k"]
    load = f"  %v = load {T}, ptr %at, align {8 * lanes}"
    step = ["  %e.next = add i64 %e, 1", "  %more = icmp slt i64 %e.next, %n"]
    again = "  br i1 %more, label %next, label %done"
    return [
        f"declare i1 @llvm.vector.reduce.or.v{lanes}i1(<{lanes} x i1>)",
        f"define internal {T} @differences(ptr %x, i64 %n, {T} %before) noinline nounwind {{",
        "entry:",
        "  br label %next",
        "next:",
        "  %e = phi i64 [ 0, %entry ], [ %e.next, %next ]",
        f"  %sum = phi {T} [ %before, %entry ], [ %sum.next, %next ]",
        *at,
        load,
        f"  %d = fsub {T} %v, %v",
        f"  %sum.next = fadd {T} %sum, %d",
        *step,
        again,
        "done:",
        f"  ret {T} %sum.next",
        "}",
        f"define internal void @blank(ptr %x, i64 %n, <{lanes} x i1> %bad) noinline nounwind {{",
        "entry:",
        "  br label %next",
        "next:",
        "  %e = phi i64 [ 0, %entry ], [ %e.next, %next ]",
        *at,
        load,
        f"  %w = select <{lanes} x i1> %bad, {T} {constant(math.nan, lanes)}, {T} %v",
        f"  store {T} %w, ptr %at, align {8 * lanes}",
        *step,
        again,
        "done:",
        "  ret void",
        "}",
    ]
